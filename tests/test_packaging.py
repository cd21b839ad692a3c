"""What is shipped is complete, says one version, and works with what is declared alone."""

import importlib.metadata
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

import excitant

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("analysis", "design", "identify", "reports", "robots")
LINK = re.compile(r"\]\(([^)#\s]+)")

IMPORT_EVERYTHING = """
import importlib, pathlib, pkgutil, sys
import excitant
home = pathlib.Path(excitant.__file__).resolve().parent
assert home.is_relative_to(pathlib.Path(sys.prefix).resolve()), home
names = [m.name for m in pkgutil.walk_packages(excitant.__path__, "excitant.")]
for name in names:
    if not name.endswith("__main__"):
        importlib.import_module(name)
print("\\n".join(names))
"""


@pytest.fixture(scope="module")
def project() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text())


def shipped() -> set[Path]:
    """Files that a wheel must hold, relative to the package."""
    inside = (file for folder in FOLDERS for file in (ROOT / folder).rglob("*") if file.is_file())
    top = [file for file in (ROOT / "src/excitant").iterdir() if file.is_file()]
    found = {file.relative_to(ROOT) for file in inside} | {Path(file.name) for file in top}
    return {file for file in found if file.suffix != ".pyc"}


def run(*words: str | Path, cwd: Path) -> str:
    """What a program prints, away from the checkout and its environment."""
    env = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(words, cwd=cwd, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def build(what: str, source: Path, target: Path) -> Path:
    """Build a wheel or an sdist from a copy without environment, caches and build products.

    The links in src/excitant are text files there, as in a zip of the repository.
    """
    made = ("build", "dist", "runs", "*.egg-info", "__pycache__", "*.pyc")
    leave = shutil.ignore_patterns(".*", *made)
    with tempfile.TemporaryDirectory() as folder:
        copy = shutil.copytree(source, Path(folder) / "copy", symlinks=True, ignore=leave)
        for link in (copy / "src/excitant").iterdir():
            if link.is_symlink():
                text = os.readlink(link)
                link.unlink()
                link.write_text(text)
        code = "import sys; from setuptools import build_meta as b; print(b.build_{}(sys.argv[1]))"
        printed = run(sys.executable, "-c", code.format(what), target, cwd=copy)
    return target / printed.splitlines()[-1]


def contents(wheel: Path) -> set[Path]:
    """Files of the package in a wheel, relative to the package."""
    with zipfile.ZipFile(wheel) as archive:
        names = (Path(name) for name in archive.namelist())
        return {name.relative_to("excitant") for name in names if name.parts[0] == "excitant"}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build("wheel", ROOT, tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def excitant_alone(wheel, project, tmp_path_factory) -> Path:
    """Programs of an environment that holds the wheel and what it declares, nothing else."""
    home = tmp_path_factory.mktemp("empty")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", home], check=True)
    [site] = home.glob("lib/python*/site-packages")
    known, wanted = set[str](), [*map(Requirement, project["project"]["dependencies"])]
    while wanted:
        name = canonicalize_name(wanted.pop().name)
        if name in known:
            continue
        known.add(name)
        distribution = importlib.metadata.distribution(name)
        for top in {file.parts[0] for file in distribution.files or ()} - {".."}:
            if not (site / top).exists():
                (site / top).symlink_to(Path(distribution.locate_file(top)))
        further = map(Requirement, distribution.requires or ())
        wanted += [r for r in further if r.marker is None or r.marker.evaluate({"extra": ""})]
    pip = [sys.executable, "-m", "pip", "--python", str(home / "bin/python"), "install", "--quiet"]
    subprocess.run([*pip, "--no-deps", "--no-index", wheel], check=True)
    return home / "bin"


def test_one_version_and_a_place_for_the_next_change(project: dict[str, Any]) -> None:
    citation, table = yaml.safe_load((ROOT / "CITATION.cff").read_text()), project["project"]
    assert table["version"] == str(citation["version"]) == excitant.__version__
    assert citation["license"] == table["license"]
    assert "## [Unreleased]" in (ROOT / "CHANGELOG.md").read_text().splitlines()


EXTRAS = ("cluster", "docs", "mjcf", "ros", "dev")


@pytest.mark.parametrize(
    ("lock", "extras"), [("requirements.lock", ()), ("requirements-dev.lock", EXTRAS)]
)
def test_lock_pins_every_requirement_and_names_no_place(project, lock, extras):
    lines = re.sub("^#.*\n", "", (ROOT / lock).read_text(), flags=re.M).replace("\\\n", "")
    pins = {}
    for line in lines.splitlines():
        name, *hashes = line.split(" --hash=")
        pin = Requirement(name)
        pins[canonicalize_name(pin.name)] = pin
        assert (pin.url, [c.operator for c in pin.specifier]) == (None, ["=="])
        assert [x for x in hashes if re.fullmatch("sha256:[0-9a-f]{64} *", x)] == hashes != [], pin
    table = project["project"]
    wanted = [*table["dependencies"], *project["build-system"]["requires"]]
    wanted += [line for extra in extras for line in table["optional-dependencies"][extra]]
    for requirement in map(Requirement, wanted):
        if requirement.name != "excitant":
            [pin] = pins[canonicalize_name(requirement.name)].specifier
            why = f"{requirement}: locked {pin.version}; run make lock"
            assert requirement.specifier.contains(pin.version), why


def test_lock_suits_the_oldest_python(project: dict[str, Any]) -> None:
    """An early 3.11 is what some systems still ship, and what pip there must find."""
    oldest = project["project"]["requires-python"].removeprefix(">=") + ".0"
    pins = re.findall("^[^ #]+", (ROOT / "requirements-dev.lock").read_text(), re.M)
    for found in importlib.metadata.distributions():
        if (pin := f"{canonicalize_name(found.name)}=={found.version}") in pins:
            suits = SpecifierSet(found.metadata.get("Requires-Python") or "")
            assert suits.contains(oldest), f"{pin} needs Python {suits}; run make lock"


def test_installed_requirements_agree(project: dict[str, Any]) -> None:
    for requirement in map(Requirement, project["project"]["dependencies"]):
        version = importlib.metadata.version(requirement.name)
        assert requirement.specifier.contains(version), f"{requirement}: installed {version}"


def test_wheel_is_complete_and_small_and_says_its_licence_and_command(wheel: Path) -> None:
    assert contents(wheel) == shipped()
    assert wheel.stat().st_size <= 5_000_000
    """And that of the library that it bundles."""
    with zipfile.ZipFile(wheel) as archive:
        info = next(n.split("/")[0] for n in archive.namelist() if ".dist-info/" in n)
        for name, words in (
            ("METADATA", "License-Expression: Apache-2.0"),
            ("entry_points.txt", "excitant = excitant.__main__:run"),
            ("licenses/LICENSE", "Version 2.0, January 2004"),
            ("licenses/reports/templates/three.LICENSE", "The MIT License"),
        ):
            assert words in archive.read(f"{info}/{name}").decode()


def test_bundled_library_says_its_version() -> None:
    code = (ROOT / "reports/templates/three.js").read_text("utf-8")
    [version] = re.findall(r"^THREE := (.+)$", (ROOT / "Makefile").read_text(), re.MULTILINE)
    said = f"/* three.js {version}, MIT, see three.LICENSE; bundled by make three */"
    assert code.splitlines()[0] == said
    assert "</script" not in code


def test_links_of_the_readme_lead_to_files_from_anywhere(project: dict[str, Any]) -> None:
    """Package indexes show the README away from its files."""
    home = re.escape(project["project"]["urls"]["Source"])
    links = LINK.findall((ROOT / "README.md").read_text("utf-8"))
    files = [re.sub(rf"^{home}/(?:blob|raw)/HEAD/", "", link) for link in links]
    assert len(files) >= 10
    assert [file for file in files if file in links or not (ROOT / file).exists()] == []


@pytest.mark.slow
def test_wheel_imports_with_nothing_else_installed(excitant_alone: Path, tmp_path: Path) -> None:
    names = run(excitant_alone / "python", "-c", IMPORT_EVERYTHING, cwd=tmp_path).split()
    assert {f"excitant.{folder}" for folder in FOLDERS} <= set(names)
    assert "6 joints" in run(excitant_alone / "excitant", "robots", "ur10", cwd=tmp_path)


@pytest.mark.slow
def test_demo_runs_with_nothing_else_installed(excitant_alone: Path, tmp_path: Path) -> None:
    words = ("demo", "--robot", "planar_2r", "-o", "d")
    printed = run(excitant_alone / "excitant", *words, cwd=tmp_path)
    assert re.search(r"^hidden .*: named$", printed, re.MULTILINE)
    assert "<svg" in (tmp_path / "d/report.html").read_text(encoding="utf-8")


def test_git_keeps_the_links(tmp_path: Path) -> None:
    """A clone or an archive holds the folders once, and links to them."""
    if not (ROOT / ".git").exists():
        pytest.skip("not a git repository")
    git = ["git", "-c", f"safe.directory={ROOT}", "-C", str(ROOT)]
    subprocess.run([*git, "archive", "-o", tmp_path / "head.tar", "HEAD"], check=True)
    (tmp_path / "head").mkdir()
    subprocess.run(["tar", "-xf", tmp_path / "head.tar", "-C", tmp_path / "head"], check=True)
    for folder in FOLDERS:
        link = tmp_path / "head/src/excitant" / folder
        assert not Path(os.readlink(link)).is_absolute()
        assert link.resolve() == (tmp_path / "head" / folder).resolve()
        assert (link / "__init__.py").is_file()


@pytest.mark.slow
def test_wheel_from_sdist_is_the_wheel_from_the_checkout(wheel: Path, tmp_path: Path) -> None:
    sdist = build("sdist", ROOT, tmp_path)
    subprocess.run(["tar", "-xf", sdist, "-C", tmp_path], check=True)
    unpacked = tmp_path / sdist.name.removesuffix(".tar.gz")
    assert contents(build("wheel", unpacked, tmp_path)) == contents(wheel)
