"""Short SVG elements say what Matplotlib's own files say."""

from __future__ import annotations

import io
import re
import xml.etree.ElementTree as ET
from base64 import b64decode

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch
from PIL import Image

from excitant.reports import drawing as draw
from excitant.reports.svg import svg

HREF = "{http://www.w3.org/1999/xlink}href"


def figure() -> Figure:
    rng = np.random.default_rng(0)
    x = np.linspace(0, 5, 60)
    drawn = Figure(figsize=(3.9, 4))
    first, last = drawn.subplots(2, 1)
    first.fill_between(x, np.sin(x) - 0.2, np.sin(x) + 0.2, color=draw.BAND)
    first.plot(x, np.sin(x), lw=1.2)
    first.plot(x[::20], np.cos(x[::20]), "o", mec="white")
    first.barh([0.0], [2.0], height=0.3, color=draw.AMBER)
    first.add_patch(FancyBboxPatch((1.0, -0.5), 1.0, 0.3, boxstyle="round"))  # bends and lines
    first.set_ylabel("torque <N·m>")
    first.text(4.0, -0.5, "torque <N·m>", rotation=90, fontsize=6)
    last.scatter(*rng.normal(size=(2, 800)), s=5, c="#9aa0a6", alpha=0.35, lw=0, rasterized=True)
    last.set_title("residual & load")
    return drawn


def theirs() -> ET.Element:
    buffer = io.BytesIO()
    look = {"format": "svg", "dpi": 150, "transparent": True}
    figure().savefig(buffer, **look)
    return ET.fromstring(buffer.getvalue())


@pytest.fixture
def both() -> tuple[ET.Element, ET.Element]:
    with draw.style():
        draw.axes(1.0)  # which begins the style
        return theirs(), ET.fromstring(svg(figure(), 'of "two" & more'))


def named(drawing: ET.Element, kind: str) -> list[ET.Element]:
    return [each for each in drawing.iter() if each.tag.rpartition("}")[2] == kind]


def turn(text: ET.Element) -> str:
    """How it is moved and turned, if it is."""
    way = text.get("transform", "")
    return "" if way.startswith("rotate(-0 ") else way


def shown(drawing: ET.Element) -> list[tuple[str, np.ndarray]]:
    """Letters and numbers of each path that shows; lines need no letter where nothing bends."""
    found = []
    for path in named(drawing, "path"):
        if path.get("style") != "fill: none":
            d = path.get("d", "")
            letters = "".join(re.findall("[A-Za-z]", d))
            bends = {"C", "Q"} & {*letters}
            numbers = np.array(re.findall(r"-?[\d.]+", d), float)
            found.append((letters if bends else letters.replace("L", ""), numbers))
    return found


def test_paths_are_where_they_were(both: tuple[ET.Element, ET.Element]) -> None:
    own, ours = map(shown, both)
    assert len(ours) == len(own) > 10
    for (way, a), (our_way, b) in zip(own, ours, strict=True):
        assert way == our_way
        np.testing.assert_allclose(b, a, rtol=0, atol=0.0501)
    uses = [[each.attrib for each in named(drawing, "use")] for drawing in both]
    for a, b in zip(*uses, strict=True):
        assert abs(float(a["x"]) - float(b["x"])) < 0.01
        assert abs(float(a["y"]) - float(b["y"])) < 0.01
        assert a["style"] == b["style"]


def test_texts_are_where_they_were(both: tuple[ET.Element, ET.Element]) -> None:
    own, ours = (named(drawing, "text") for drawing in both)
    assert [text.text for text in own] == [text.text for text in ours]
    assert {"torque <N·m>", "residual & load", "−1"} <= {text.text for text in ours}
    for a, b in zip(own, ours, strict=True):
        assert a.get("style") == b.get("style")
        places = [re.findall(r"-?[\d.]+", f"{t.get('x')} {t.get('y')} {turn(t)}") for t in (a, b)]
        np.testing.assert_allclose(*np.array(places, float), atol=0.01)


def test_a_picture_of_points_looks_the_same(both: tuple[ET.Element, ET.Element]) -> None:
    pictures, places = [], []
    for drawing, key in zip(both, (HREF, "href"), strict=True):
        (image,) = named(drawing, "image")
        with Image.open(io.BytesIO(b64decode(image.get(key, "").partition(",")[2]))) as picture:
            over = Image.new("RGBA", picture.size, "white")
            over.alpha_composite(picture.convert("RGBA"))
            pictures.append(np.asarray(over.convert("L"), float))
        places.append([float(image.get(k, "")) for k in ("x", "y", "width", "height")])
    own, ours = pictures
    assert own.shape == ours.shape
    assert (own < 250).mean() > 0.01
    assert np.abs(own[::-1] - ours).mean() < 2.0  # theirs stands on its head
    x, y, width, height = places[0]
    np.testing.assert_allclose(places[1], [x, -y, width, height], atol=0.01)


def test_it_is_an_element_for_a_page(both: tuple[ET.Element, ET.Element]) -> None:
    _, ours = both
    assert ours.attrib == {
        "role": "img",
        "aria-label": 'of "two" & more',
        "viewBox": "0 0 280.8 288",
    }
    ids = [each.get("id") for each in ours.iter() if each.get("id")]
    assert len(ids) == len({*ids}) > 0
    with draw.style():
        draw.axes(1.0)
        again, other = svg(figure(), 'of "two" & more'), svg(figure(), "another")
    assert ET.tostring(ours) == ET.tostring(ET.fromstring(again))
    assert not {*ids} & {each.get("id") for each in ET.fromstring(other).iter()}
    assert "<metadata" not in again
    assert not re.search(r"\d\.\d{3}", re.sub(r'href="data[^"]*"|<text.*?</text>', "", again))
