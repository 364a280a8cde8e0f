"""Heliarch as a wheel in another folder: it runs there, and says when a module was replaced."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from running import REPOSITORY


def run(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a program of Python with what is installed in a folder first on its path."""
    return subprocess.run(
        [sys.executable, "-m", *words],
        cwd=folder.parent,
        env={**os.environ, "PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
        check=False,
        timeout=150,
    )


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the wheel that is built from the checkout's sdist."""
    folder = tmp_path_factory.mktemp("elsewhere") / "packages"
    # A build leaves files behind, and would take those of an earlier one.
    left_out = shutil.ignore_patterns(".*", "build", "runs", "tests", "docs", "*.egg-info")
    checkout = shutil.copytree(REPOSITORY, folder.with_name("checkout"), ignore=left_out)
    offline = ("--no-deps", "--no-build-isolation", "--no-index", "--disable-pip-version-check")
    build = "from setuptools import build_meta; print(build_meta.build_sdist('.'))"
    built = subprocess.run(
        [sys.executable, "-c", build], cwd=checkout, capture_output=True, text=True, check=True
    )
    sdist = checkout / built.stdout.split()[-1]
    done = run(folder, "pip", "install", *offline, "--target", str(folder), str(sdist))
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.processes
def test_the_wheel_launches_with_page_and_report(installed: Path) -> None:
    words = ("--duration", "5", "--set", "processes=cluster", "--page", "--report", "--out", "run")
    done = run(installed, "heliarch", "launch", "oahu", *words)
    assert done.returncode == 0, done.stderr
    assert "page: http" in done.stdout
    assert (installed.parent / "run" / "report.html").stat().st_size > 1_000_000


def test_verify_says_that_other_code_made_a_recording(installed: Path) -> None:
    simulated = ("heliarch", "simulate", "oahu", "--duration", "5", "--out", "simulated")
    assert run(installed, *simulated).returncode == 0
    assert "other code" not in run(installed, "heliarch", "verify", "simulated").stdout
    with (installed / "agents" / "direct.py").open("a", encoding="utf-8") as source:
        source.write("# A change that decides nothing.\n")
    verified = run(installed, "heliarch", "verify", "simulated")
    assert verified.returncode == 0, verified.stdout
    assert "made by other code than this" in verified.stdout


def test_a_module_of_another_package_is_named(installed: Path, tmp_path: Path) -> None:
    (tmp_path / "first" / "scenarios").mkdir(parents=True)
    (tmp_path / "first" / "scenarios" / "__init__.py").touch()
    found_first = run(tmp_path / "first", "heliarch", "scenarios")
    assert "the module scenarios is not Heliarch's" in found_first.stderr
    (installed / "agents" / "__init__.py").write_text("from nowhere import Agent\n")
    overwritten = run(installed, "heliarch", "scenarios")
    (line,) = overwritten.stderr.splitlines()
    assert overwritten.returncode == 1
    assert "agents" in line
    assert "pipx" in line
