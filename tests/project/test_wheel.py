"""The package as others get it: wheel and sdist, installed alone, used from another folder."""

import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

from tests import ROOT

USE = """
import calibrate, jdem, sys

assert "checkout" not in calibrate.__file__ and sys.argv[1] not in calibrate.__file__
loop = calibrate.contact([20, 2, 32, -28], out="contact")
lab = calibrate.load_lab(calibrate.bundled_lab())
found = calibrate.diagnose(calibrate.bundled_lab("trumao_curves"), out="diagnosed")
page = calibrate.report(found)
print(loop.normal_force_n.max(), lab.name, found.verdict, page.path, len(jdem.__all__), sep="\\n")
"""


def run(*command: object, where: Path) -> str:
    done = subprocess.run(list(map(str, command)), cwd=where, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """A folder with wheel and sdist."""
    folder = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "hatchling", "build", "-d", folder, where=ROOT)
    return folder


@pytest.fixture(scope="module")
def python(built, tmp_path_factory) -> Path:
    """The interpreter of an environment that holds the wheel, and sees what it depends on."""
    place = tmp_path_factory.mktemp("environment")
    venv.create(place, with_pip=False)
    own = Path(sysconfig.get_path("purelib", vars={"base": str(place)}))
    own.joinpath("dependencies.pth").write_text(sysconfig.get_path("purelib"))
    wheel = next(built.glob("*.whl"))
    run(sys.executable, "-m", "pip", "install", "--no-deps", "--target", own, wheel, where=place)
    return place / "bin" / "python"


@pytest.mark.slow
def test_the_wheel_works_by_its_public_names(python, tmp_path):
    said = run(python, "-c", USE, ROOT, where=tmp_path).split("\n")
    assert float(said[0]) > 0.1 and said[1].startswith("wheat after rice")
    assert Path(said[3]).name == "report.html" and (tmp_path / said[3]).stat().st_size > 50_000
    version = run(python, "-m", "calibrate", "--version", where=tmp_path)
    assert version.startswith("calibrate 0.1.0")


@pytest.mark.slow
def test_both_archives_hold_what_is_used_and_nothing_of_the_workshop(built):
    wheel = zipfile.ZipFile(next(built.glob("*.whl"))).namelist()
    with tarfile.open(next(built.glob("*.tar.gz"))) as archive:
        sdist = archive.getnames()
    for needed in ("calibrate/__init__.pyi", "calibrate/soils/wheat_after_rice.toml"):
        assert needed in wheel and any(name.endswith(needed) for name in sdist)
    assert {name.split("/")[0] for name in wheel if ".dist-info" not in name} == {
        "jdem",
        "calibrate",
    }
    assert not any("/.ci/" in name for name in sdist)
