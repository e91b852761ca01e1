"""The type stubs: they agree with the module, take what it takes and refuse what it refuses."""

from __future__ import annotations

import importlib.metadata
import subprocess
import sys
from pathlib import Path

import vkdenoise


def run(*arguments: str) -> None:
    done = subprocess.run([sys.executable, "-m", *arguments], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_stubs_agree_with_the_module() -> None:
    run("mypy.stubtest", "vkdenoise._vkdenoise")


def test_users_are_checked() -> None:
    """Every ignored line of typed.py must be an error: mypy warns of an ignore without one."""
    run("mypy", "--strict", str(Path(__file__).with_name("typed.py")))


def test_the_package_says_that_it_is_typed() -> None:
    folder = Path(vkdenoise.__file__).parent
    assert (folder / "py.typed").exists() and (folder / "_vkdenoise.pyi").exists()


def test_the_version_is_the_packages() -> None:
    assert vkdenoise.__version__ == importlib.metadata.version("vkdenoise")


def test_everything_is_described() -> None:
    for name in vkdenoise.__all__:
        thing = getattr(vkdenoise, name)
        assert thing.__doc__, name
        members = vars(thing).items() if isinstance(thing, type) else ()
        for member, value in members:
            assert member.startswith("_") or value.__doc__, f"{name}.{member}"
