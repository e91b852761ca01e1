"""The parameters of the bilateral filter by samples per pixel. Written by tune_bilateral.py, not by hand.

Best mean PSNR over 24 views of the training scenes ashtray, bathroom2, car, car2, classroom, dining-room, house,
living-room-3, spaceship, staircase, staircase2, tire. There, noisy -> filtered in dB: 1 spp 13.61 -> 26.99; 4 spp
18.45 -> 29.39; 32 spp 26.30 -> 32.82; 4 spp, colour only 18.45 -> 28.10.
"""
WITH_FEATURES = {
    1: {"spatial": 8.0, "color": 1.43, "guide": 1.0, "bend": 0.0125, "albedo": 0.4, "normal": 0.075, "depth": 0.1},
    4: {"spatial": 6.67, "color": 0.5, "guide": 1.0, "bend": 0.05, "albedo": 0.28, "normal": 0.075, "depth": 0.025},
    32: {"spatial": 3.92, "color": 0.0362, "guide": 1.4, "bend": 0.8, "albedo": 0.2, "normal": 0.0536, "depth": 0.1},
}
COLOR_ONLY = {
    4: {"spatial": 4.2, "color": 0.25, "guide": 1.2, "bend": 0.1},
}
