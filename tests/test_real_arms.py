"""What an engineer checks first after a run on a real arm, by the commands that they would type."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

Records = dict[str, Any]
Verbs = Callable[..., Records]
FRICTION = (".Fv", ".Fc")
LIGHT = 3_000_000  # bytes of a page
SETS = {
    "ur10": "unisa_exciting",
    "ur10e": "id_8harm_20s --validate val_ptp_10_points",
    "panda": "gaz_traj1",
    "rokae_xmate3": "rec02",
    "dualarm_v2": "exc_13p5 exc_15p7 --validate exc_52p2",
}
KNOWN: dict[tuple[str, str], Records] = {}  # by verb and set, for all tests


@pytest.fixture
def ran(data_folder: Path, excitant: Callable[..., Any], tmp_path: Path) -> Verbs:
    """``ran("identify", "ur10e")``: result of a verb on the recordings of a set."""

    def run(verb: str, name: str) -> Records:
        if (verb, name) in KNOWN:
            return KNOWN[verb, name]
        words = f"{'--recording ' if verb == 'analyze' else ''}{SETS[name]}"
        words += " --no-experiments" if verb == "diagnose" else ""
        found = excitant(f"{verb} {data_folder / name} {words} --json -o {tmp_path / verb}").result
        assert (tmp_path / verb / "report.html").stat().st_size < LIGHT
        return KNOWN.setdefault((verb, name), dict(found))

    return run


def friction(content: Any) -> Iterator[tuple[str, Records]]:
    """Entries with a name and a value, wherever they stand in a result."""
    if isinstance(content, dict):
        name = str(content.get("name", ""))
        if "value" in content and "unit" in content and name.endswith(FRICTION):
            yield name, content
    for each in content.values() if isinstance(content, dict) else content:
        if isinstance(each, dict | list):
            yield from friction(each)


@pytest.mark.slow
def test_an_upper_arm_weighs_what_an_upper_arm_weighs(ran: Verbs) -> None:
    """UR10e, currents, one motion to another: once 1.98 kg, 0.95 m along 0.61 m of link."""
    link = ran("identify", "ur10e")["links"][1]
    mass, centre = link["mass"], link["centre"]
    assert abs(mass["value"] - mass["given"]) < 0.5 * mass["given"]
    assert math.dist(centre["value"], centre["given"]) < 0.1
    assert link["moved"] is None


@pytest.mark.slow
def test_the_same_recording_gives_the_same_friction_in_three_verbs(ran: Verbs) -> None:
    """`analyze` to all digits; `diagnose` within ±, or a note names what shares the torque."""
    identified, analyzed, diagnosed = (ran(v, "ur10e") for v in ("identify", "analyze", "diagnose"))
    known, again = dict(friction(identified)), dict(friction(analyzed))
    assert known
    for coefficient, entry in known.items():
        keys = ("value", "std", "unit")
        assert [again[coefficient][k] for k in keys] == [entry[k] for k in keys]
    shared = " ".join(note for note in diagnosed["notes"] if "share the torque" in note)
    for coefficient, entry in friction(diagnosed["findings"]):
        mine = known[coefficient]
        assert entry["unit"] == mine["unit"]
        if entry["std"] is None:
            continue  # undecided
        std = math.hypot(entry["std"], mine["std"])
        joint = coefficient.rpartition(".")[0]
        assert abs(entry["value"] - mine["value"]) <= 3 * std or joint in shared, coefficient
    one, other = (r.get("drive_gain_Nm_per_A") or [] for r in (identified, diagnosed))
    assert [k or 0 for k in one] == pytest.approx([k or 0 for k in other], rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", SETS)
def test_no_mass_moves_by_half_without_a_line_that_says_why(ran: Verbs, name: str) -> None:
    result = ran("identify", name)
    said = " ".join(note for note in result["notes"] if "moved by half" in note)
    for link in result["links"]:
        mass = link["mass"]
        if abs(mass["value"] - mass["given"]) >= 0.5 * mass["given"]:
            assert f"{link['link']}: mass {mass['given']:.3g} → {mass['value']:.3g} kg" in said
            assert mass["decided_by"] in ("data", "both", "prior")
