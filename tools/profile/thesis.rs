//! What the thesis published, to stand beside what is measured. Its times are of PyTorch, fp32, on one NVIDIA L40S.

/// A row of its Tables 4.1, 4.2, 4.4 and 4.5.
pub struct NetworkRow {
    pub name: &'static str,
    pub parameters_m: f64,
    /// At 128x128.
    pub gflop: f64,
    /// At 1024x1024.
    pub seconds: f64,
    pub psnr: f64,
    pub ssim: f64,
}

const fn row(name: &'static str, parameters_m: f64, gflop: f64, seconds: f64, psnr: f64, ssim: f64) -> NetworkRow {
    NetworkRow { name, parameters_m, gflop, seconds, psnr, ssim }
}

/// The ten networks.
pub const NETWORKS: [NetworkRow; 10] = [
    row("jsa_baseline", 33.29, 29.20, 1.140, 34.845, 0.914),
    row("shsa_100", 28.06, 24.45, 1.019, 34.214, 0.908),
    row("shsa_075", 25.77, 22.34, 1.009, 34.881, 0.916),
    row("shsa_050", 24.13, 20.83, 0.971, 34.353, 0.913),
    row("shsa_025", 23.14, 19.92, 0.948, 34.467, 0.913),
    row("film_cnn", 33.43, 30.57, 1.006, 34.521, 0.906),
    row("symmetric_decoder", 33.05, 21.32, 0.545, 34.850, 0.916),
    row("three_stage", 6.01, 12.19, 0.467, 34.858, 0.917),
    row("expanded_patch", 6.07, 3.70, 0.115, 34.466, 0.906),
    row("hybrid", 4.44, 3.03, 0.096, 33.151, 0.864),
];

/// Sides of the maps of its Table 4.3.
const BLOCK_SIDES: [u32; 5] = [128, 256, 512, 1024, 2048];
/// Milliseconds of a block there: channels, FiLM-CNN, SH-JSA.
const BLOCKS: [(u32, [f64; 5], [f64; 5]); 2] = [
    (32, [0.342, 1.027, 5.754, 36.719, 152.833], [0.518, 1.122, 6.943, 40.644, 169.780]),
    (64, [0.415, 1.943, 11.684, 84.065, 342.233], [0.435, 1.973, 12.337, 83.625, 341.210]),
];

/// Milliseconds of a FiLM-CNN and of an SH-JSA block, where the table has such a row.
pub fn blocks(channels: u32, side: u32) -> Option<(f64, f64)> {
    let at = BLOCK_SIDES.iter().position(|&published| published == side)?;
    BLOCKS.iter().find(|(published, ..)| *published == channels).map(|(_, film, attention)| (film[at], attention[at]))
}

/// Its section 4.3.1: one convolution on a 1024x1024 map. The channels are not stated; 32 fits the rates.
pub const CONVOLUTIONS: [&str; 3] = [
    "standard 3x3: 1.261 ms in all, 529.23 us of it the Winograd kernel; 32.24 M shared-memory instructions; L2 hit rate 96.4 %",
    "depthwise-separable: 1.590 ms in all, 460.23 us depthwise + 404.34 us pointwise; 20.96 M global-memory instructions",
    "so the standard one is 1.26 times as fast there",
];
