"""Keys of a plant: made, checked before a run, and refused in one line where they are wrong."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from command_line import done, refusal
from running import small_plant

KEYS = Path("keys/small")
SHORT = "--duration 5"


@pytest.fixture
def plant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A scenario in a working folder that has its keys."""
    monkeypatch.chdir(tmp_path)
    path = small_plant(tmp_path / "plant")
    done("keys", path)
    return path


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_keys_are_for_their_owner_alone(plant: str) -> None:
    keys = sorted(KEYS.glob("*.key"))
    assert len(keys) == 11, "nine agents, the operator and the authority"
    assert all(key.stat().st_mode & 0o077 == 0 for key in keys)


def test_git_does_not_publish_keys(plant: str) -> None:
    for words in ("init -q", "add ."):
        subprocess.run(["git", *words.split()], check=True)
    found = subprocess.run(["git", "ls-files"], check=True, capture_output=True, text=True)
    assert "keys/" not in found.stdout


def test_renewed_certificates_are_of_the_same_authority_and_keys(plant: str) -> None:
    before = content(KEYS)
    done("keys", plant)
    same = {name for name, its in content(KEYS).items() if its == before[name]}
    assert same == {".gitignore", "ca.pem", *(name for name in before if name.endswith(".key"))}


def spoil(how: str, plant: str) -> None:
    """Do something to the keys of a plant."""
    certificate, key = KEYS / "c1.pem", KEYS / "c1.key"
    done("keys", plant, "--out", "other")
    match how:
        case "expired":
            done("keys", plant, "--days", "0.0000001")
        case "expires soon":
            done("keys", plant, "--days", "0.02")
        case "of another plant":
            shutil.copy("other/c1.pem", certificate)
        case "of another agent":
            shutil.copy(KEYS / "c2.pem", certificate)
        case "for everybody":
            key.chmod(0o644)
        case "of older keys":
            shutil.copy("other/c1.key", key)
        case "gone":
            certificate.unlink()
        case "broken":
            certificate.write_text("nothing")
        case "never made":
            shutil.rmtree(KEYS)


@pytest.mark.parametrize(
    ("how", "words", "said"),
    [
        ("expired", SHORT, "valid up to the end"),
        ("expires soon", "--pace 1 --duration 30m", "valid up to the end"),
        ("of another plant", SHORT, "another plant"),
        ("of another plant", f"{SHORT} --external c1", "c1.pem"),
        ("of another agent", SHORT, "a certificate for c1, got one for c2"),
        ("for everybody", SHORT, "c1.key"),
        ("of older keys", SHORT, "c1.key: expected the key of"),
        ("gone", SHORT, "c1.pem: no such file"),
        ("broken", SHORT, "c1.pem"),
        ("never made", SHORT, "heliarch keys"),
        ("right", f"{SHORT} --address 10.1.2.3", "10.1.2.3"),
        ("right", f"{SHORT} --on 10.0.0.2=c2/*", "expected --address"),
    ],
)
def test_wrong_keys_are_refused_before_anything_starts(
    plant: str, how: str, words: str, said: str
) -> None:
    spoil(how, plant)
    assert said in refusal("launch", plant, *words.split(), "--secure")
    assert not Path("runs").exists()


@pytest.mark.parametrize("lost", ["ca.key", "ca.pem"])
def test_half_an_authority_and_that_of_another_plant_are_refused(
    plant: str, lost: str, tmp_path: Path
) -> None:
    other = small_plant(tmp_path / "other", ('name = "small"', 'name = "large"'))
    assert "certificate authority of large" in refusal("keys", other, "--out", KEYS)
    (KEYS / lost).unlink()
    before = content(KEYS)
    assert lost in refusal("keys", plant)
    assert content(KEYS) == before
