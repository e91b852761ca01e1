"""Intel OIDN beside vkdenoise: a peer for `vkdenoise-bench stress` and `vkdenoise-bench pareto`.

    vkdenoise-bench stress --peer 'OIDN=venv/bin/python tools/measure/oidn_peer.py' --markdown stress.md

An argument is OIDN's quality: high (default), balanced or fast.
"""
import sys

import pyoidn

from peer import serve


def denoise(color, albedo, normal, quality):
    """As a renderer's preview would call it. OIDN takes no depth, and a normal only beside an albedo."""
    features = {}
    if albedo is not None:
        features["albedo"] = albedo
        if normal is not None:
            features["normal"] = normal
    return pyoidn.denoise(color, **features, hdr=True, clean_aux=False, quality=quality)


if __name__ == "__main__":
    quality = sys.argv[1] if len(sys.argv) > 1 else "high"
    serve(lambda color, albedo, normal, _: denoise(color, albedo, normal, quality))
