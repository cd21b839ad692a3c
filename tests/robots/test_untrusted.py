"""Descriptions by others: nothing is run, nothing elsewhere is read, and nothing hangs."""

import contextlib
import os
import resource
import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest
import robustness_inputs
from marks import refused, slow
from robustness import READERS

from excitant.exceptions import BadInput, BadRobot, ExcitantError, UnknownName
from excitant.files import write_folder
from excitant.identify import load_dataset, load_recording
from excitant.robots import Motion, Robot, load_robot, meshes, mjcf_model, torque, xacro
from excitant.robots import mjcf as reader
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
XACRO: dict[str, tuple[str, ...]] = {  # what is said, what stands before the links
    r"in line 1 of .*arm\.xacro is refused: .*plain values": (
        "${[c for c in ().__class__.__base__.__subclasses__() if c.__name__ == 'catch_warnings']"
        "[0]()._module.__builtins__['__import__']('os').system('touch ran')}",
    ),
    "asks for the environment, which is not read": ("$(env SECRET)",),
    "no data": ("$(eval env)", "${math}"),
    "refused": ("${9**9**8}", "${9**9**9**9}"),
    "that long": ("${'a'*10**10}", "${len([0]*10**9)}", "${'x' * 200_000}"),
    "too large": (
        *("${'%100000000000d' % 1}", "${len(list(range(10**9)))}"),
        *("${('a'*90000).join(['b']*90000)}", "${('a'*90000).replace('a', 'b'*90000)}"),
    ),
    "too many": ("${sum(x for x in range(99999) for y in range(99999))}",),
    "too": ("${list(python.map(list, python.map(range, [99999]*99999)))}",),
    "digits": ("${7**9999 * 7**9999}",),
    "too much": (
        *("${round(5, -10**9)}", "${math.factorial(10**7)}", properties("ab", "${P}${P}")),
        *(properties("${[1]}", "${[P, P]}"), f'<xacro:macro name="m0"/>{CALLS}<xacro:m60/>'),
    ),
    "too deep": ("${" + "-" * 50000 + "1}",),
    "values": ("${math.values()}",),
    "loop": ('<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>',),
    "50 deep, perhaps in a loop": ('<xacro:include filename="arm.xacro"/>',),
    "--package FOLDER": (
        *("${xacro.load_yaml('../secret.yaml')}", '<xacro:include filename="link.yaml"/>'),
        *("${xacro.load_yaml('/etc/os-release')}", '<xacro:include filename="../secret.yaml"/>'),
    ),
    "symbolic links": ('<xacro:include filename="loop"/>',),
    "no file": ('<xacro:include filename="pipe"/>',),
    "last part": ('<xacro:include filename="/*/*/*/*.xml"/>',),
    "no package 'etc'": ('<xacro:include filename="$(find etc)/passwd"/>',),
    "more than 300000 values": ("${xacro.load_yaml('aliases.yaml')}",),
    "nested more than 50 deep": ("${xacro.load_yaml('self.yaml')}",),
    "constructor": ("${xacro.load_yaml('runs.yaml')}",),
    OUTSIDE: (
        *("${__builtins__}", "${'x'.format(1)}", "${python.type(1)}", "${python.vars(1)}"),
        *("${python['vars']}", "$(eval 'x'.format)", "${math.__loader__}", "$(eval __builtins__)"),
        *("${python.abs.__self__}", "$(eval radians.__self__)", "${(x for x in [1]).gi_frame}"),
        *("${(lambda: ().__class__.__bases__)()}", "${[c for c in [().__class__]][0].__base__}"),
        "$(eval [c for c in [[].__class__]][0].__base__)",
        "${[g.gi_frame.f_back for g in [(x for x in [1])]]}",
        "${exec('import os; os.system(&quot;touch ran&quot;)')}",
    ),
    "100 elements deep": ("<a>" * 100_000 + "</a>" * 100_000,),
}
TEXTS = [(text, words) for words, texts in XACRO.items() for text in texts]


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


@pytest.mark.parametrize("case", range(len(TEXTS)))
def test_a_xacro_file_runs_reads_and_repeats_nothing_it_may_not(folder, monkeypatch, case):
    monkeypatch.setattr(xacro, "SECONDS", 2)
    before, words = TEXTS[case]
    if words in (OUTSIDE, "--package FOLDER"):  # refused by what it says, not by a limit
        monkeypatch.setattr(xacro, "in_child", lambda work, *task, **_: work(*task))
    path, start = folder / "arm.xacro", sum(os.times()[:4])  # of this process and its children
    path.write_text(arm(before=before if before.startswith("<") else f'<a b="{before}"/>'))
    said = refused(words, load_robot, path, error=BadRobot)
    assert sum(os.times()[:4]) - start < SECONDS
    assert "hidden" not in said
    assert len(said) < 1000
    assert not (folder / "ran").exists()


def test_no_environment_and_only_files_of_given_packages_are_read(folder: Path) -> None:
    path = folder / "arm.xacro"
    path.write_text(arm(name="$(optenv SECRET plain)"))
    robot = load_robot(path)
    assert robot.name == "plain"
    assert any("$(optenv SECRET) is taken as not set" in n for n in robot.notes)
    path.write_text(arm(name="$(optenv ABSENT_HERE plain)"))
    assert load_robot(path).notes == ()
    path.write_text(arm(name="${(lambda: xacro.load_yaml('../secret.yaml')['key'])()}"))
    (folder / "robot.yaml").write_text("model: arm.xacro\ntrust_xacro: true\n")
    refused("plain values", load_robot, folder / "robot.yaml", error=BadRobot)
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


PARTS = {  # of an MJCF, by which it names a file
    "include": ("", '<include file="{}"/>'),
    "model": ("", '<asset><model name="m" file="{}"/></asset>'),
    "mesh": ('<geom type="mesh" mesh="m"/>', '<asset><mesh name="m" file="{}"/></asset>'),
    "hfield": ("", '<asset><hfield name="m" file="{}" size="1 1 1 1"/></asset>'),
}
BUILT = '<asset><mesh name="m" builtin="{}" params="{}"/></asset>'
SHAPES = ("cone 1{}00000 .1", "torus {}000000 .3", "supersphere 1{}00 1 1", "wedge {}00 999 .5 1 1")
GREEDY = {  # what stands before the bodies, and in one, with a number
    "flexcomp": ("", '<flexcomp name="f" type="grid" count="{} 20 20" spacing="1 1 1" dim="3"/>'),
    "drive": ('<compiler><lengthrange mode="all" inttotal="1e9" timestep="{}e-8"/></compiler>'
              '<actuator><general joint="j"/></actuator>', ""),
    "bodies": ("", '<body><geom size=".1"/></body>' * 20_000),
    "copies": ("", '<replicate count="20"><replicate count="{}"/></replicate>'),
    "cable": ("", '<composite prefix="c" count="{}000 9 1" type="cable"/>'),
    "grid": ('<asset><hfield name="h" nrow="{}00" ncol="99" size="1 1 1 1"/></asset>', ""),
    "keys": ('<size nkey="{}00000000"/>', ""),
    "memory": ('<size memory="{}T"/>', ""),
}  # fmt: skip
GREED, ELSEWHERE = (
    "too much|no arm needs|builds more|memory",
    "--package|missing|no file|cannot read",
)


def attacks(rng: np.random.Generator) -> dict[str, tuple[str, str]]:
    """Small MJCF that take much, and such that name a file beside their folder."""
    found, number = {}, str(rng.integers(21, 25))
    for shape in SHAPES:
        built = BUILT.format(*shape.format(number).split(" ", 1))
        found[shape.split()[0]] = mjcf(built, PARTS["mesh"][0]), GREED
    for name, (before, inside) in GREEDY.items():
        found[name] = mjcf(before.format(number), inside.format(number)), GREED
    for kind, (shape, part) in PARTS.items():
        name = {"mesh": "w.stl", "hfield": "h.bin"}.get(kind, "up.xml")
        ways = (f"../{name}", f"none{number}/../../{name}", f"..\\{name}", f"linked{name[-4:]}")
        ways += (f"a\\..\\..\\{name}", f".//../{name}", "pipe")
        texts = [mjcf(part.format(way), shape) for way in ways]
        texts.append(mjcf('<compiler assetdir=".."/>' + part.format(name), shape))
        found |= {f"{kind}{k}": (text, ELSEWHERE) for k, text in enumerate(texts)}
    return {f"{name}.xml": case for name, case in found.items()}


FILES: dict[str, tuple[str, str]] = {  # what stands in a file, what is said
    "itself.xml": (mjcf('<include file="itself.xml"/>'), "already included"),
    "chain.xml": (mjcf('<include file="i0.xml"/>'), "200 files"),
    "levels.xml": (mjcf('<include file="i99.xml"/>'), "100 levels"),
    "place.xml": (mjcf("", '<body pos="nan 0 0"/>'), 'body_2_weld.*xyz="nan" is not a number'),
    "large.xml": (mjcf("", '<body pos="1e200 0 0"/>'), r'body_2_weld.*xyz="1e\+200" is beyond'),
    "option.xml": (mjcf('<option gravity="0 0 inf"/>'), "gravity"),
    "nested.xml": ("<mujoco>" + "<a>" * 9999 + "</a>" * 9999 + "</mujoco>", "deep"),
    "elsewhere.yaml": ("model: ../arm.urdf\n", "--package"),
    "by_link.yaml": ("model: link.yaml\n", "--package"),
    "by_loop.yaml": ("model: loop\n", "does not exist"),
    "root.yaml": ("model: arm.urdf\npackages: [/]\n", "--package"),
    "sibling.yaml": ("model: arm.urdf\npackages: [../beside]\n", "--package"),
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


DRAWN = [(seed, file) for seed in range(3) for file in attacks(np.random.default_rng(0))]


@pytest.mark.parametrize(("seed", "file"), [*((0, file) for file in FILES), *DRAWN])
def test_other_files_neither_reach_nor_build_what_they_may_not(
    folder, capfd, monkeypatch, seed, file
):
    monkeypatch.setattr(reader, "SECONDS", 3)
    text, words = (FILES | attacks(np.random.default_rng(seed)))[file]
    field = np.int32([2, 2]).tobytes() + np.float32([0, 0, 1, 1]).tobytes()
    (folder.parent / "h.bin").write_bytes(field)
    for name in ("up.xml", "w.stl", "h.bin"):
        (folder / f"linked{name[-4:]}").symlink_to(folder.parent / name)
    (folder.parent / "up.xml").write_text(mjcf("").replace('name="', 'name="hidden'))
    shutil.copy(DATA / "wedge.stl", folder.parent / "w.stl")
    for k in range(201 if file in ("chain.xml", "levels.xml") else 0):
        part = f'<a><include file="i{k + 1}.xml"/></a>' if k < 200 else ""
        (folder / f"i{k}.xml").write_text(f"<mujoco>{part}</mujoco>")
    if text:
        (folder / file).write_text(text)
    start, before = sum(os.times()[:4]), {*folder.iterdir()}  # of this process and its children
    assert "hidden" not in refused(words, load_robot, folder / file)
    assert sum(os.times()[:4]) - start < SECONDS
    assert resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss < 2 << 20  # KiB
    assert {*folder.iterdir()} == before  # such as a log of MuJoCo's
    assert capfd.readouterr() == ("", "")


def test_shapes_without_numbers_are_refused_without_a_word_of_pinocchio(folder, capfd):
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


def test_a_data_set_names_no_robot_elsewhere(folder: Path) -> None:
    sidecar = folder / "dataset.json"
    sidecar.write_text('{"kinematics": {"urdf": "../arm.urdf"}}')
    refused("outside its folder.*ROBOT and the paths", load_dataset, folder)
    (folder / "robot.urdf").symlink_to(folder.parent / "arm.urdf")  # its owner's, whatever it names
    sidecar.write_text("{}")
    assert load_dataset(folder).robot.nv == 1
    sidecar.write_text("[" * 100_000)
    refused(r"dataset\.json", load_dataset, folder, error=BadInput)


# Meshes and packages

DAE = """<COLLADA version="1.4.1"><library_nodes><node id="n"><instance_node url="#n"/></node>
</library_nodes><library_visual_scenes><visual_scene id="s">{}</visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""
DEEP = "<node>" * 200_000 + "</node>" * 200_000
MESHES = {  # name, scale, content
    "nothing": ("w.stl", "0 0 0", None),
    "flat": ("w.stl", "1 0 1", None),
    "line": ("w.stl", "1 1e-9 1e-9", None),
    "point": ("w.stl", "1e-40 1e-40 1e-40", None),
    "number": ("bad.stl", "1 1 1", None),
    "loop": ("bad.dae", "1 1 1", DAE.format('<node><instance_node url="#n"/></node>')),
    "deep": ("bad.dae", "1 1 1", DAE.format(DEEP)),
    "format": ("bad.gltf", "1 1 1", "{}"),
}


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("kind", MESHES)
def test_a_mesh_ends_no_process(folder: Path, kind: str, seed: int) -> None:
    rng, (file, scale, text) = np.random.default_rng(seed), MESHES[kind]
    content = bytearray((DATA / "wedge.stl").read_bytes())
    (folder / "good.stl").write_bytes(content)
    if kind == "number":
        at = 96 + 50 * rng.integers(2) + 4 * rng.integers(9)  # a coordinate of a corner
        content[at : at + 4] = np.float32([np.nan, np.inf][seed]).tobytes()
    (folder / file).write_bytes(text.encode() if text else content)
    size = " ".join(rng.permutation(scale.split()))
    shape = shaped('<mesh filename="good.stl"/>').replace("</collision>", "</collision>{}")
    bad = SHAPE.format(f'<mesh filename="{file}" scale="{size}"/>')
    (folder / "a.urdf").write_text(shape.format(bad))
    assert file in refused("mesh", scene, load_robot(folder / "a.urdf"), error=BadRobot)


@pytest.mark.parametrize("library", ["pipe", "../secret.yaml"])
def test_a_mesh_opens_no_other_file_and_a_flat_one_is_a_solid(folder: Path, library: str) -> None:
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl m\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    (folder / "a.obj").write_text(f"mtllib {library}\n{text}")
    full, flat = meshes.hulls([(folder / "a.obj", (1.0, 1.0, z)) for z in (2.0, 1e-9)], "a.urdf")
    assert np.ptp(full.points(), axis=0).tolist() == [1, 1, 2]
    assert 0 < np.ptp(flat.points(), axis=0)[2] < 1e-5


@pytest.mark.parametrize("seed", range(6))
def test_a_package_is_the_files_own_or_one_that_the_user_names(folder, monkeypatch, seed):
    """None beside a folder around it, whether by its name, a link, or the word of a robot.yaml."""
    name, where = f"pack{np.random.default_rng(seed).integers(99)}", folder / "a" / "b"
    package = (where.parent, folder, folder.parent)[seed % 3] / "share" / name
    package = package.parent.parent / name if seed % 2 else package
    for place in (package, where):
        place.mkdir(parents=True)
    (package / "package.xml").write_text(f"<package><name>{name}</name></package>")
    (package / "part.xacro").write_text("<robot/>")
    shutil.copy(DATA / "wedge.stl", package / "w.stl")
    if seed > 2:
        (where / name).symlink_to(package)
    mesh = SHAPE.format(f'<mesh filename="package://{name}/w.stl"/>')
    include = f'<xacro:include filename="$(find {name})/part.xacro"/>'
    (where / "arm.xacro").write_text(arm(before=include, shape=mesh))
    (where / "arm.urdf").write_text(arm(shape=mesh))
    (where / "arm.yaml").write_text(f"model: arm.xacro\npackages: [{package}]\n")
    refused("--package", load_robot, where / "arm.xacro")
    refused("--package", load_robot, where / "arm.yaml")
    assert "1 of 1 collision meshes" in unchecked(load_robot(where / "arm.urdf"), None)
    arms = [load_robot(where / "arm.xacro", packages=[package])]
    variable = "ROS_PACKAGE_PATH" if seed % 2 else "AMENT_PREFIX_PATH"
    monkeypatch.setenv(variable, str(package.parent if seed % 2 else package.parents[1]))
    arms += map(load_robot, (where / "arm.xacro", where / "arm.urdf"))
    assert all(unchecked(robot, None).startswith("self-collision;") for robot in arms)


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
    monkeypatch.setattr(reader, "in_child", lambda _, *task, **__: mjcf_model.described(*task))
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


LONG = "x" * 300  # longer than file systems take, which pathlib refuses with an OSError
NAMING: dict[str, str] = {
    "robot.yaml": f"model: {LONG}.urdf",
    "dataset.json": f'{{"kinematics": {{"urdf": "{LONG}.urdf"}}}}',
    "arm.xml": f'<mujoco><include file="{LONG}"/></mujoco>',
    "arm.xacro": f'<robot xmlns:xacro="x"><xacro:include filename="{LONG}"/></robot>',
    "package.xacro": f'<robot xmlns:xacro="x"><xacro:include filename="$(find {LONG})/a"/></robot>',
}


@pytest.mark.parametrize("name", NAMING)
def test_a_name_too_long_for_a_file_is_refused(name: str, tmp_path: Path) -> None:
    (file := tmp_path / name).write_text(NAMING[name], "utf-8")
    read = load_dataset if name == "dataset.json" else load_robot
    refused("xxx|no robot model", read, tmp_path if name == "dataset.json" else file)


def test_a_name_too_long_from_the_caller_is_refused(planar: Robot) -> None:
    refused("xxx", load_robot, f"{LONG}.urdf")
    refused("xxx", load_robot, LONG, error=UnknownName)
    refused("xxx", load_dataset, LONG, error=UnknownName)
    refused("xxx", load_recording, f"{LONG}.csv", planar)
    refused("xxx", write_folder, LONG, {"a": "b"})
