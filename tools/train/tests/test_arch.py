"""Parameter counts of the ten networks (design table, "true parameters") and the JSON form."""
import json
import unittest

import torch

from vkdn.arch import ARCHITECTURES, from_dict
from vkdn.model import Denoiser

TRUE_PARAMETERS = {
    "jsa_baseline": 31_595_632,
    "shsa_100": 28_068_550,
    "shsa_075": 25_776_078,
    "shsa_050": 24_135_254,
    "shsa_025": 23_146_078,
    "film_cnn": 31_760_035,
    "symmetric_decoder": 31_368_365,
    "three_stage": 5_743_389,
    "expanded_patch": 5_798_749,
    "hybrid": 4_445_489,
}
HYBRID = (
    '{"name":"hybrid","channels":32,"window":8,"patch":2,"decoder":"symmetric","stages":['
    '{"encoder_blocks":1,"decoder_blocks":1,"heads":1,"block":{"kind":"film_cnn","conv":"standard"}},'
    '{"encoder_blocks":2,"decoder_blocks":2,"heads":2,"block":{"kind":"sh_jsa","ratio":0.25}},'
    '{"encoder_blocks":4,"decoder_blocks":4,"heads":4,"block":{"kind":"sh_jsa","ratio":0.25}}],'
    '"bottleneck":{"blocks":2,"heads":8,"block":{"kind":"sh_jsa","ratio":0.25}}}'
)


class ArchitectureTest(unittest.TestCase):
    def test_parameter_counts(self):
        self.assertEqual(ARCHITECTURES.keys(), TRUE_PARAMETERS.keys())
        with torch.device("meta"):
            for name, count in TRUE_PARAMETERS.items():
                with self.subTest(name):
                    model = Denoiser(ARCHITECTURES[name])
                    self.assertEqual(sum(p.numel() for p in model.parameters()), count)

    def test_json(self):
        self.assertEqual(json.dumps(ARCHITECTURES["hybrid"].to_dict(), separators=(",", ":")), HYBRID)
        for arch in ARCHITECTURES.values():
            self.assertEqual(from_dict(json.loads(json.dumps(arch.to_dict()))), arch)

    def test_multiples(self):
        multiples = {n: ARCHITECTURES[n].multiple for n in ("jsa_baseline", "three_stage", "expanded_patch", "hybrid")}
        self.assertEqual(multiples, {"jsa_baseline": 128, "three_stage": 64, "expanded_patch": 128, "hybrid": 128})
