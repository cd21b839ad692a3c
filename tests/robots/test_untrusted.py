"""Descriptions by others: nothing is run, nothing elsewhere is read, and nothing hangs."""

import contextlib
import os
import shutil
import time
import warnings
from pathlib import Path

import mujoco
import numpy as np
import pytest
import robustness_inputs
from known_arms import Call
from marks import slow
from robustness import READERS

from excitant.exceptions import BadInput, BadRobot, ExcitantError, UnknownName
from excitant.files import write_folder
from excitant.identify import load_dataset, load_recording
from excitant.robots import Motion, Robot, load_robot, torque, xacro
from excitant.robots.expressions import MATH, PYTHON, Names, Refused, evaluate
from excitant.robots.geometry import scene, unchecked

DATA = Path(__file__).parent / "data"
BODY = """<inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>"""
SECONDS = 15.0  # of processor time: what no file may take


def arm(name: str = "arm", before: str = "", shape: str = "", origin: str = 'xyz="0 0 1"') -> str:
    return f"""<robot name="{name}" xmlns:xacro="http://www.ros.org/wiki/xacro">{before}
    <link name="a">{BODY}</link><link name="b">{BODY}{shape}</link>
    <joint name="j" type="revolute"><parent link="a"/><child link="b"/><origin {origin}/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""


def properties(first: str, twice: str, levels: int = 60) -> str:
    """Each property is made of the one before, twice; then the last is used."""
    values = [first, *(twice.replace("P", f"p{k}") for k in range(levels))]
    chain = (f'<xacro:property name="p{k}" value="{value}"/>' for k, value in enumerate(values))
    return f'{"".join(chain)}<a b="${{p{levels}}}"/>'


CALL = '<xacro:macro name="m{}"><xacro:m{}/><xacro:m{}/></xacro:macro>'
CALLS = "".join(CALL.format(k + 1, k, k) for k in range(60))
OUTSIDE = "plain values of bounded size|no data|vars|not defined"
XACRO: dict[str, tuple[str, str]] = {  # what stands before the links, what is said
    "command": (
        "${[c for c in ().__class__.__base__.__subclasses__() if c.__name__ == 'catch_warnings']"
        "[0]()._module.__builtins__['__import__']('os').system('touch ran')}",
        r"in line 1 of .*arm\.xacro is refused: .*plain values",
    ),
    "environment": ("$(env SECRET)", "asks for the environment, which is not read"),
    "environment evaluated": ("$(eval env)", "no data"),
    "power": ("${9**9**8}", "refused"),
    "powers": ("${9**9**9**9}", "refused"),
    "text": ("${'a'*10**10}", "that long"),
    "list": ("${len([0]*10**9)}", "that long"),
    "range": ("${len(list(range(10**9)))}", "too large"),
    "loops": ("${sum(x for x in range(99999) for y in range(99999))}", "too many"),
    "lists of lists": ("${list(python.map(list, python.map(range, [99999]*99999)))}", "too"),
    "product of numbers": ("${7**9999 * 7**9999}", "digits"),
    "digits": ("${round(5, -10**9)}", "too much"),
    "width": ("${'%100000000000d' % 1}", "too large"),
    "join": ("${('a'*90000).join(['b']*90000)}", "too large"),
    "replace": ("${('a'*90000).replace('a', 'b'*90000)}", "too large"),
    "factorial": ("${math.factorial(10**7)}", "too much"),
    "nested": ("${" + "-" * 50000 + "1}", "too deep"),
    "module": ("${math}", "no data"),
    "functions": ("${math.values()}", "values"),
    "doubled text": (properties("ab", "${P}${P}"), "too much"),
    "doubled list": (properties("${[1]}", "${[P, P]}"), "too much"),
    "macros": (f'<xacro:macro name="m0"/>{CALLS}<xacro:m60/>', "too much"),
    "macro in itself": ('<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>', "loop"),
    "file in itself": ('<xacro:include filename="arm.xacro"/>', "50 deep, perhaps in a loop"),
    "file elsewhere": ('<xacro:include filename="../secret.yaml"/>', "--package FOLDER"),
    "link elsewhere": ('<xacro:include filename="link.yaml"/>', "--package FOLDER"),
    "loop of links": ('<xacro:include filename="loop"/>', "symbolic links"),
    "pipe": ('<xacro:include filename="pipe"/>', "no file"),
    "folders": ('<xacro:include filename="/*/*/*/*.xml"/>', "last part"),
    "package etc": ('<xacro:include filename="$(find etc)/passwd"/>', "no package 'etc'"),
    "YAML elsewhere": ("${xacro.load_yaml('../secret.yaml')}", "--package FOLDER"),
    "YAML by its path": ("${xacro.load_yaml('/etc/os-release')}", "--package FOLDER"),
    "YAML of aliases": ("${xacro.load_yaml('aliases.yaml')}", "more than 300000 values"),
    "YAML in itself": ("${xacro.load_yaml('self.yaml')}", "nested more than 50 deep"),
    "YAML that runs": ("${xacro.load_yaml('runs.yaml')}", "constructor"),
    "frame": ("${(x for x in [1]).gi_frame}", OUTSIDE),
    "frames of a run": ("${[g.gi_frame.f_back for g in [(x for x in [1])]]}", OUTSIDE),
    "class in a nested scope": ("${[c for c in [().__class__]][0].__base__}", OUTSIDE),
    "class of a substitution": ("$(eval [c for c in [[].__class__]][0].__base__)", OUTSIDE),
    "lambda": ("${(lambda: ().__class__.__bases__)()}", OUTSIDE),
    "name": ("${__builtins__}", OUTSIDE),
    "name in a substitution": ("$(eval __builtins__)", OUTSIDE),
    "format": ("${'x'.format(1)}", OUTSIDE),
    "format in a substitution": ("$(eval 'x'.format)", OUTSIDE),
    "type": ("${python.type(1)}", OUTSIDE),
    "vars": ("${python.vars(1)}", OUTSIDE),
    "vars by key": ("${python['vars']}", OUTSIDE),
    "method of a function": ("${python.abs.__self__}", OUTSIDE),
    "function of a substitution": ("$(eval radians.__self__)", OUTSIDE),
    "builtin": ("${exec('import os; os.system(&quot;touch ran&quot;)')}", OUTSIDE),
    "loader": ("${math.__loader__}", OUTSIDE),
    "deep": ("<a>" * 100_000 + "</a>" * 100_000, "100 elements deep"),
    "long": ("${'x' * 200_000}", "that long"),
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to read from, and beside it what nobody may read."""
    monkeypatch.setenv("SECRET", "hidden")
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    (tmp_path / "secret.yaml").write_text("key: hidden\n")
    (tmp_path / "arm.urdf").write_text(arm())
    (here / "link.yaml").symlink_to(tmp_path / "secret.yaml")
    (here / "loop").symlink_to(here / "loop")
    os.mkfifo(here / "pipe")
    levels = "".join(f"a{k + 1}: &a{k + 1} [{f'*a{k}, ' * 9}]\n" for k in range(30))
    (here / "aliases.yaml").write_text(f"a0: &a0 [1]\n{levels}")
    joined = "".join(f"a{k + 1}: &a{k + 1} {{<<: [{f'*a{k}, ' * 9}]}}\n" for k in range(30))
    (here / "joined.yaml").write_text(f"a0: &a0 {{k: 1}}\n{joined}")
    (here / "self.yaml").write_text("a: &a [*a]\n")
    (here / "runs.yaml").write_text('a: !!python/object/apply:os.system ["touch ran"]\n')
    return here


@pytest.mark.parametrize("name", XACRO)
def test_a_xacro_file_runs_reads_and_repeats_nothing_it_may_not(folder, refused, monkeypatch, name):
    monkeypatch.setattr(xacro, "SECONDS", 2)
    before, words = XACRO[name]
    if words in (OUTSIDE, "--package FOLDER"):  # refused by what it says, not by a limit
        monkeypatch.setattr(xacro, "in_child", lambda work, *task, **_: work(*task))
    path, start = folder / "arm.xacro", sum(os.times()[:4])  # of this process and its children
    path.write_text(arm(before=before if before.startswith("<") else f'<a b="{before}"/>'))
    said = refused(words, load_robot, path, error=BadRobot)
    assert sum(os.times()[:4]) - start < SECONDS
    assert "hidden" not in said
    assert len(said) < 1000
    assert not (folder / "ran").exists()


def test_what_the_environment_holds_is_taken_as_not_set(folder: Path) -> None:
    path = folder / "arm.xacro"
    path.write_text(arm(name="$(optenv SECRET plain)"))
    robot = load_robot(path)
    assert robot.name == "plain"
    assert any("$(optenv SECRET) is taken as not set" in n for n in robot.notes)
    path.write_text(arm(name="$(optenv ABSENT_HERE plain)"))
    assert load_robot(path).notes == ()


def test_no_file_makes_expressions_run(folder: Path, refused: Call) -> None:
    path = folder / "arm.xacro"
    path.write_text(arm(name="${(lambda: xacro.load_yaml('../secret.yaml')['key'])()}"))
    (folder / "robot.yaml").write_text("model: arm.xacro\ntrust_xacro: true\n")
    refused("plain values", load_robot, folder / "robot.yaml", error=BadRobot)


def test_files_of_a_package_that_is_given_are_read(folder: Path) -> None:
    path = folder / "arm.xacro"
    path.write_text(arm(name="${xacro.load_yaml('../secret.yaml').key}"))
    assert load_robot(path, packages=[folder.parent]).name == "hidden"
    (folder.parent / "package.xml").write_text("<package><name>arms</name></package>")
    assert load_robot(path).name == "hidden"  # the package that holds the file
    path.write_text(arm(name="${xacro.load_yaml('$(find arms)/secret.yaml')['key']}"))
    assert load_robot(path).name == "hidden"


@pytest.mark.parametrize("params", ["a:=" + "b" * 60 + "'", "a:=" + "''" * 60 + "x'"])
def test_parameters_of_a_macro_are_read_at_once(folder: Path, params: str) -> None:
    """By a pattern of xacro's own they would take years."""
    path, start = folder / "arm.xacro", sum(os.times()[:4])  # of this process and its children
    params = params.replace("'", "&apos;")
    path.write_text(arm(before=f'<xacro:macro name="m" params="{params}"/>'))
    assert load_robot(path).nv == 1
    assert sum(os.times()[:4]) - start < 5


def test_expressions_have_the_values_of_python() -> None:
    values = {"a": 2.5, "xs": [3, 1, 2], "text": "a,b"}
    names = Names(MATH | PYTHON, values.__getitem__)
    for expression in (
        *("-a ** 2 // 3 % 2 + 1e3", "xs[0] if a > 2 and not xs[1] == 2 else xs[-1]"),
        *("[x * y for x in xs for y in xs if x != y][1:3]", "1 < a <= 3 != 4"),
        *("text.split(',')[1].upper() + '%5.2f' % a", "3 in xs or 'a' not in text"),
        *("max(xs, key=abs) + abs(-2)", "(1, 2) + (3,)"),
    ):
        assert evaluate(expression, names) == eval(expression, values)
    for expression in ("a.real", "text.__len__", "abs.call", "xs.append(1)", "(y := 1)", "a @ a"):
        with pytest.raises(Refused):
            evaluate(expression, names)


SHAPE = "<collision><geometry>{}</geometry></collision>"


def mjcf(before: str, inside: str = "") -> str:
    return f"""<mujoco>{before}<worldbody><body name="a"><joint name="j"/><geom size=".1"/>{inside}
    </body></worldbody></mujoco>"""


def shaped(shape: str) -> str:
    return arm(shape=SHAPE.format(shape))


def meshed(file: str, before: str = "") -> str:
    mesh = f'{before}<asset><mesh name="m" file="{file}"/></asset>'
    return mjcf(mesh, '<geom type="mesh" mesh="m"/>')


FILES: dict[str, tuple[str, str]] = {  # what stands in a file, what is said
    "include.xml": (mjcf('<include file="../up.xml"/>'), "--package"),
    "itself.xml": (mjcf('<include file="itself.xml"/>'), "already included"),
    "chain.xml": (mjcf('<include file="i0.xml"/>'), "200 files"),
    "mesh.xml": (meshed("../w.stl"), "--package"),
    "meshdir.xml": (meshed("w.stl", '<compiler meshdir=".."/>'), "--package"),
    "model.xml": (mjcf('<asset><model file="../up.xml"/></asset>'), "--package"),
    "copies.xml": (mjcf("", '<replicate count="99999999"/>'), "builds more"),
    "twice.xml": (mjcf("", 2 * '<replicate count="99">' + 2 * "</replicate>"), "builds more"),
    "grid.xml": (mjcf('<asset><hfield nrow="9999" ncol="9"/></asset>'), "nrow"),
    "keys.xml": (mjcf('<size nkey="2000000000"/>'), "nkey"),
    "place.xml": (mjcf("", '<body pos="nan 0 0"/>'), r"not finite .*\(pos\)"),
    "large.xml": (mjcf("", '<body pos="1e200 0 0"/>'), r"beyond .*\(pos\)"),
    "option.xml": (mjcf('<option gravity="0 0 inf"/>'), "gravity"),
    "nested.xml": ("<mujoco>" + "<a>" * 9999 + "</a>" * 9999 + "</mujoco>", "deep"),
    "elsewhere.yaml": ("model: ../arm.urdf\n", "--package"),
    "by_link.yaml": ("model: link.yaml\n", "--package"),
    "by_loop.yaml": ("model: loop\n", "does not exist"),
    "root.yaml": ("model: arm.urdf\npackages: [/]\n", "too wide"),
    "aliases.yaml": ("", "300000 values"),
    "joined.yaml": ("", "10000 entries"),
    "runs.yaml": ("", "constructor"),
    "long.yaml": ("convention: standard\ndh: [{m: 1, a: 1e12, I: {}}]\n", "up to 1e9"),
    "nested.urdf": ("<robot>" + "<a>" * 99_999 + "</a>" * 99_999 + "</robot>", "deep"),
    "many.urdf": ("<robot>" + "<a/>" * 210_000 + "</robot>", "200000 elements"),
    "huge.urdf": ("<robot>" + " " * 32_000_000, "more than 32 MB"),
    "links.urdf": (f"<robot>{'<link/>' * 1001}</robot>", "1001 links"),
    "doctype.urdf": ('<!DOCTYPE a [<!ENTITY b "c">]><robot name="&b;"/>', "entities"),
    "xyz.urdf": (arm(origin='xyz="0 0"'), "joint 'j': xyz=\"0 0\" holds 2 numbers"),
    "rpy.urdf": (arm(origin='rpy="0 0"'), "joint 'j': rpy=\"0 0\" holds 2 numbers"),
    "none.urdf": (arm(origin='rpy=""'), "holds 0 numbers"),
    "scale.urdf": (
        shaped('<mesh filename="m" scale="a b c"/>').replace("collision", "visual"),
        "link 'b': scale=\"a\" is not a number",
    ),
    "size.urdf": (shaped('<box size="1 1"/>'), "'b': size=\"1 1\" holds 2 numbers instead of 3"),
    "sphere.urdf": (shaped('<sphere radius="1e99"/>'), "beyond any arm's size"),
}


@pytest.mark.parametrize("file", FILES)
def test_other_files_neither_reach_nor_build_what_they_may_not(folder, refused, capfd, file):
    text, words = FILES[file]
    (folder.parent / "up.xml").write_text("<mujoco/>")
    shutil.copy(DATA / "wedge.stl", folder.parent / "w.stl")
    for k in range(201 if file == "chain.xml" else 0):
        (folder / f"i{k}.xml").write_text(f'<mujoco><include file="i{k + 1}.xml"/></mujoco>')
    if text:
        (folder / file).write_text(text)
    start, before = time.process_time(), {*folder.iterdir()}
    refused(words, load_robot, folder / file)
    assert time.process_time() - start < SECONDS
    assert {*folder.iterdir()} == before  # such as a log of MuJoCo's
    assert capfd.readouterr() == ("", "")


def test_shapes_without_numbers_are_refused_without_a_word_of_pinocchio(folder, refused, capfd):
    path = folder / "a.urdf"
    for shape in ("<box/>", "<sphere/>", '<cylinder radius="1"/>', "<mesh/>", "<ball/>", ""):
        path.write_text(shaped(shape))
        with contextlib.suppress(BadRobot):
            scene(load_robot(path))
    (folder / "bad.stl").write_text("not a mesh")
    path.write_text(shaped('<mesh filename="bad.stl"/>'))
    refused("a.urdf.*bad.stl", scene, load_robot(path), error=BadRobot)
    assert capfd.readouterr() == ("", "")


def test_meshes_elsewhere_count_as_not_found_and_how_to_allow_them_is_said(folder: Path) -> None:
    path, mesh = folder / "a.urdf", folder.parent / "w.stl"
    shutil.copy(DATA / "wedge.stl", mesh)
    for name in ("../w.stl", str(mesh), f"file://{mesh}"):
        path.write_text(shaped(f'<mesh filename="{name}"/>'))
        said = unchecked(load_robot(path), None)
        assert "1 of 1 collision meshes not found" in said
        assert "(1 outside the description's folder: --package FOLDER allows them)" in said
        said = unchecked(load_robot(path, packages=[folder.parent]), None)
        assert said.startswith("self-collision;")


def test_a_data_set_names_no_robot_elsewhere(folder: Path, refused: Call) -> None:
    sidecar = folder / "dataset.json"
    sidecar.write_text('{"kinematics": {"urdf": "../arm.urdf"}}')
    refused("outside its folder.*ROBOT and the paths", load_dataset, folder)
    (folder / "robot.urdf").symlink_to(folder.parent / "arm.urdf")  # its owner's, whatever it names
    sidecar.write_text("{}")
    assert load_dataset(folder).robot.nv == 1
    sidecar.write_text("[" * 100_000)
    refused(r"dataset\.json", load_dataset, folder, error=BadInput)


# Damaged at random

NAMES = [name for name in READERS if name.startswith("data/")]
CASES = [*((name, 60) for name in NAMES), *(slow(name, 200) for name in NAMES)]
CASES += [slow("data/gantry.urdf", 4000)]
MORE = {  # of what a description can have, in the gantry
    b'<axis xyz="0 0 -1"/>': b'<dynamics damping="1" friction="2"/>',
    b'<link name="hand">': SHAPE.format('<cylinder radius="0.05" length="0.3"/>').encode(),
}


@pytest.mark.parametrize(("file", "count"), CASES)
def test_a_damaged_description_works_or_is_refused_in_one_line(tmp_path, monkeypatch, file, count):
    shutil.copytree(DATA, tmp_path / "data")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(xacro, "in_child", lambda work, *task, **_: work(*task))
    values = (*robustness_inputs.VALUES, "1e-308", "0x10", "٣")
    monkeypatch.setattr(robustness_inputs, "VALUES", values)
    path, files = tmp_path / file, {*tmp_path.rglob("*")}
    content = path.read_bytes()
    for place, more in MORE.items():
        content = content.replace(place, place + more)
    for seed in range(count):
        rng = np.random.default_rng(seed)
        damaged = robustness_inputs.damaged_text if seed % 4 else robustness_inputs.damaged_bytes
        path.write_bytes(damaged(rng, content))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                robot = READERS[file](tmp_path, file)
            except ExcitantError as error:
                said = str(error)
                assert "\n" not in said, seed
                assert path.suffix != ".urdf" or str(path) in said, (seed, said)
                continue
        assert len({*robot.joints}) == robot.nv >= 1
        assert np.isfinite(robot.phi).all()
        motion = Motion(np.arange(5.0), *rng.uniform(-1, 1, (3, 5, robot.nv)))
        assert np.isfinite(torque(robot, motion)).all(), seed
        low, high = robot.limits.position.T
        assert (low <= high).all()
        assert (robot.limits.velocity >= 0).all()
        assert (robot.limits.torque >= 0).all()
    assert {*tmp_path.rglob("*")} == files
    assert mujoco.get_mju_user_warning() is None


LONG = "x" * 300  # longer than file systems take, which pathlib refuses with an OSError
NAMING: dict[str, str] = {
    "robot.yaml": f"model: {LONG}.urdf",
    "dataset.json": f'{{"kinematics": {{"urdf": "{LONG}.urdf"}}}}',
    "arm.xml": f'<mujoco><include file="{LONG}"/></mujoco>',
    "arm.xacro": f'<robot xmlns:xacro="x"><xacro:include filename="{LONG}"/></robot>',
    "package.xacro": f'<robot xmlns:xacro="x"><xacro:include filename="$(find {LONG})/a"/></robot>',
}


@pytest.mark.parametrize("name", NAMING)
def test_a_name_too_long_for_a_file_is_refused(name: str, tmp_path: Path, refused: Call) -> None:
    (file := tmp_path / name).write_text(NAMING[name], "utf-8")
    read = load_dataset if name == "dataset.json" else load_robot
    refused("xxx|no robot model", read, tmp_path if name == "dataset.json" else file)


def test_a_name_too_long_from_the_caller_is_refused(planar: Robot, refused: Call) -> None:
    refused("xxx", load_robot, f"{LONG}.urdf")
    refused("xxx", load_robot, LONG, error=UnknownName)
    refused("xxx", load_dataset, LONG, error=UnknownName)
    refused("xxx", load_recording, f"{LONG}.csv", planar)
    refused("xxx", write_folder, LONG, {"a": "b"})
