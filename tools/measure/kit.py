"""What measuring shares with the training kit next door: files, metrics, pre-processing and the network itself."""
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "train"))

from vkdn import images, metrics, model, preprocess, weights  # noqa: E402, F401
from vkdn.denoise import denoise as run_pytorch, prepare  # noqa: E402, F401
