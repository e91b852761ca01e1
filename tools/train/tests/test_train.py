"""The trainer from command line to weights file, on two small scenes, and what runs it by a plan."""
import json
import subprocess
import sys
import tempfile
import time
import unittest
from pathlib import Path
from unittest import mock

import torch

from tests import small
from vkdn import archive, burst, checkpoint, packs, views, weights
from vkdn.options import parse
from vkdn.train import Trainer, starting_model


def arguments(folder, *more):
    paths = ["--data", str(folder / "pairs"), "--out", str(folder / "run")]
    return [*paths, "--hold-out", "held", "--device", "cpu", *more]


def events(folder, kind):
    return [e for e in map(json.loads, (folder / "run" / "log.jsonl").read_text().splitlines()) if e["event"] == kind]


class TrainTest(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.folder = Path(temporary.name)
        small.write_pairs(self.folder / "pairs")
        self.start = self.folder / "small.safetensors"
        weights.write(self.start, small.network(), {})
        silent = mock.patch("builtins.print")
        silent.start()
        self.addCleanup(silent.stop)

    def test_a_run_stops_goes_on_and_leaves_weights(self):
        own = ["--from", str(self.start), "--batch", "2", "--share", "1", "--parallel", "2", "--lr", "1e-4"]
        own += ["--change", "clean=0.5", "--change", "clean_below=1", "--change", "shift=4"]
        small.write_crops(self.folder / "crops")
        own += ["--crops", str(self.folder / "crops")]
        Trainer(parse(None, arguments(self.folder, *own, "--steps", "2"))).run()
        Trainer(parse(None, arguments(self.folder, *own, "--steps", "3", "--resume"))).run()
        self.assertEqual([e["step"] for e in events(self.folder, "start")], [0, 2])
        self.assertEqual(events(self.folder, "start")[1]["crops"], {"side": 128, "real": 1, "procedural": 2})
        found = events(self.folder, "evaluation")
        self.assertEqual([e["step"] for e in found], [0, 2, 3])
        self.assertEqual(set(found[-1]["psnr"]), {"1", "4", "32", "hard"})
        self.assertGreater(found[-1]["psnr"]["32"][0], found[-1]["psnr"]["1"][0])
        self.assertEqual(set(found[-1]["clean"]), {"change", "psnr"})
        model, record = checkpoint.load_model(self.folder / "run" / "last.pt")
        self.assertEqual((record["steps"], record["changes"]["clean"], record["changes"]["shift"]), (3, 0.5, 4))
        self.assertEqual((record["energy"], record["clean_weight"], record["scenes"]), (5.0, 4.0, ["shown"]))
        before = small.network().state_dict()
        self.assertTrue(any(not torch.equal(w, before[name]) for name, w in model.state_dict().items()))
        weights.write(self.folder / "out.safetensors", model, record)

    def test_starts(self):
        model, new = starting_model(parse(None, arguments(self.folder, "--from", str(self.start))))
        self.assertEqual((new, model.arch), ([], small.network().arch))
        model, new = starting_model(parse(None, arguments(self.folder, "--from", str(self.start), "--head", "gated")))
        self.assertTrue(model.arch.head.gated)
        self.assertFalse(any(name.startswith("enc") for name in new))
        with self.assertRaises(SystemExit), mock.patch("sys.stderr"):
            parse(None, arguments(self.folder, "--change", "cleen=1"))

    def test_packs_folders_and_larger_views(self):
        pack = self.folder / "pairs.zip"
        self.assertEqual(packs.pack(self.folder / "pairs", pack, {"held"}), 2)
        (folder, packed) = (views.read(source, {"held"}) for source in (self.folder / "pairs", pack))
        self.assertEqual([about for about, _ in folder], [about for about, _ in packed])
        self.assertEqual([about["held"] for about, _ in folder], [True, False])
        pieces = views.crops([small.view(1, side=384), small.view(2, side=512)])
        self.assertEqual([about["side"] for about, _ in pieces], [256] * 8)
        self.assertTrue((pieces[3][1]["reference"] == small.view(1, side=384)[1]["reference"][:, 128:, 128:]).all())
        (self.folder / "pairs" / "shown" / "v0" / "spp0004.exr").unlink()
        with self.assertRaisesRegex(ValueError, "spp0004"):
            views.read(self.folder / "pairs", set())

    def test_a_plan_trains_from_an_archive(self):
        plan = {
            "train": ["--data", "pairs.zip", "--batch", "1", "--steps", "1", "--device", "cpu"],
            "trainings": [
                {"name": "good", "share": 1, "arguments": ["--from", "start.zip"]},
                {"name": "bad", "share": 1, "arguments": ["--from", "start.zip", "--arch", "none"]},
            ],
        }
        (self.folder / "plan.json").write_text(json.dumps(plan))
        there = self.folder / "there"
        line = ["archive", "--plan", str(self.folder / "plan.json"), "--data", str(self.folder / "pairs")]
        line += ["--hold-out", "held", "--start", f"start={self.start}", "--out", str(there)]
        with mock.patch.object(sys, "argv", line):
            archive.main()
        (self.folder / "pairs").rename(self.folder / "gone")
        command = [sys.executable, "-m", "vkdn.burst", "--plan", "plan.json", "--seconds", "90", "--out", "out"]
        subprocess.run(command, cwd=there, check=True, capture_output=True)
        self.assertEqual(weights.read(there / "out" / "good.safetensors")[1]["training"]["steps"], 1)
        self.assertIn("| good | eager | 1 |", (there / "out" / "table.md").read_text())
        left = sorted(file.name for file in (there / "out").iterdir())
        self.assertEqual(left, ["good.safetensors", "log.jsonl", "table.md"])


class OverseerTest(unittest.TestCase):
    def sleeper(self):
        process = subprocess.Popen(["sleep", "60"])
        self.addCleanup(burst.end, process)
        return process

    def test_a_silent_trainer_is_ended(self):
        maker = burst.Maker({}, time.time(), 1, None, Path("/nowhere"))
        for silence, until in ((0.2, 60.0), (60.0, 0.2)):
            with mock.patch.object(burst, "SILENCE", silence), mock.patch.object(burst, "say"):
                self.assertFalse(burst.wait(self.sleeper(), Path("/nowhere/log"), time.time() + until, maker))

    def test_a_late_maker_of_crops_is_ended_and_nobody_waits_for_it(self):
        with tempfile.TemporaryDirectory() as out, mock.patch.object(burst, "spawn", lambda *_: self.sleeper()):
            plan = {"crops": {"share": 0.0, "arguments": []}}
            (Path(out) / "runs").mkdir()
            maker = burst.Maker(plan, time.time() - burst.LATE - 1, 1, None, Path(out))
            with mock.patch.object(burst, "say"):
                maker.check()
            self.assertIsNotNone(maker.process.returncode)
            self.assertTrue((maker.folder / burst.COMPLETE).exists())
