"""A source distribution holds all that the repository does: its tests run unpacked."""

import re
import shutil
import subprocess
import tomllib
from fnmatch import fnmatch
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

#: Added by hatchling itself, or of use in the repository only
ELSE = {"pyproject.toml", "LICENSE", ".gitignore", ".ci"}

#: Extras that a user's work may need; conda has none
USED = ("reference", "phantom", "parallel", "sensors", "viewer", "live", "webrtc")


def test_every_file_is_included():
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("not a checkout: what the repository holds is unknown")
    listed = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    tops = {name.partition("/")[0] for name in listed.stdout.splitlines()}
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    included = settings["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
    found = {top for top in tops if any(fnmatch(f"/{top}", p) for p in included)}
    assert tops - found <= ELSE
    for pattern in included:
        assert any(fnmatch(f"/{top}", pattern) for top in tops), f"{pattern}: stale"


def test_the_container_file_names_what_is_there():
    """Files that it copies, the extras it installs and the command it starts."""
    text = (ROOT / "Containerfile").read_text(encoding="utf-8")
    lines = text.replace("\\\n", " ").splitlines()
    copied = [name for line in lines if line[:4] == "COPY" for name in line.split()[1:]]
    copied = [name for name in copied if not name.startswith("/src")]
    assert {"pyproject.toml", "ttus_opt"} <= set(copied)
    for name in copied:
        assert (ROOT / name).exists(), name
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    forced = project["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    assert set(forced) <= set(copied)
    (extras,) = re.findall(r'"/src\[(.*?)\]"', text)
    offered = project["project"]
    assert set(extras.split(",")) <= set(offered["optional-dependencies"])
    (entry,) = re.findall(r'^ENTRYPOINT \["(.*?)"\]', text, re.M)
    assert entry in offered["scripts"]


def test_the_recipe_of_conda_requires_what_the_package_does():
    """The same version, requirements and Python, by conda-forge's names."""
    names = {
        "matplotlib": "matplotlib-base",
        "netCDF4": "netcdf4",
        "opencv-python-headless": "py-opencv",
    }
    given = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    project = given["project"]
    text = (ROOT / "conda" / "recipe.yaml").read_text(encoding="utf-8")

    def listed(name):
        (run,) = re.findall(rf"^  {name}:\n((?:    - .*\n)+)", text, re.M)
        return dict(line[6:].partition(" ")[::2] for line in run.splitlines())

    expected = {"python": project["requires-python"]}
    for word in project["dependencies"]:
        name, pin = re.fullmatch(r"([\w-]+)(.*)", word).groups()
        # conda-forge does not count the wheels of one version of OpenCV
        expected[names.get(name, name)] = pin.replace("4.10.0.84", "4.10.0")
    assert listed("run") == expected
    extras = project["optional-dependencies"]
    optional = {word for name in USED for word in extras[name] if "[" not in word}
    assert listed("run_constraints") == {
        name: pin
        for name, pin in (re.fullmatch(r"([\w-]+)(.*)", w).groups() for w in optional)
    }
    assert f'version: "{project["version"]}"' in text
    assert f"- ttus-opt = {project['scripts']['ttus-opt']}" in text
