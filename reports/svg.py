"""Figures of Matplotlib as short SVG elements; import this where Matplotlib may be imported."""

from __future__ import annotations

import hashlib
import io
import re
from base64 import b64encode
from html import escape
from typing import Any

from matplotlib.backends import backend_mixed, backend_svg
from matplotlib.figure import Figure
from PIL import Image

_COLOURS = 16
_DPI = 150  # of an image
_SVG: Any = backend_svg  # without types, as the next
_MIXED: Any = backend_mixed
_CODES = [b"M", b"L", b"Q", b"C", b"z"]


class _ShortRenderer(_SVG.RendererSVG):  # type: ignore[misc]
    """Matplotlib's renderer, with a tenth of a point in paths and a palette in images.

    What identifies the drawing and its parts is left out.
    """

    _sizes: dict[tuple[Any, ...], tuple[float, float, float]] = {}  # noqa: RUF012  # of all texts

    def _write_metadata(self, metadata: Any) -> None:
        pass

    def open_group(self, s: str, gid: str | None = None) -> None:
        pass

    def close_group(self, s: str) -> None:
        pass

    def _convert_path(
        self,
        path: Any,
        transform: Any = None,
        clip: Any = None,
        simplify: Any = None,
        sketch: Any = None,
    ) -> str:
        window = (0.0, 0.0, self.width, self.height) if clip else None
        found: bytes = _SVG._path.convert_to_string(
            path, transform, window, simplify, sketch, 1, _CODES, False
        )
        written = found.decode("ascii").replace("\n", " ").strip()
        return (
            written if "C" in written or "Q" in written else written.replace(" L ", " ")
        )

    def draw_image(
        self, gc: Any, x: float, y: float, im: Any, transform: Any = None
    ) -> None:
        """A picture of points, which with few colours takes a third of the room."""
        packed = io.BytesIO()
        (height, width) = im.shape[:2]
        few = Image.fromarray(im[::-1]).quantize(_COLOURS, Image.Quantize.FASTOCTREE)
        few.save(packed, "png")
        scale = 72.0 / self.image_dpi
        place = {"x": x, "y": self.height - y - scale * height}
        size = {"width": scale * width, "height": scale * height}
        self.writer.element(
            "image",
            href=f"data:image/png;base64,{b64encode(packed.getvalue()).decode()}",
            **{name: f"{value:.2f}" for name, value in (place | size).items()},
        )

    def get_text_width_height_descent(
        self, s: str, prop: Any, ismath: Any
    ) -> tuple[float, float, float]:
        """Size of a text, which is measured once for all drawings."""
        key = (s, hash(prop), ismath)
        if key not in self._sizes:
            self._sizes[key] = super().get_text_width_height_descent(s, prop, ismath)
        return self._sizes[key]


def svg(figure: Figure, label: str) -> str:
    """An element to show in a page, which says in words what is drawn."""
    for patch in (figure.patch, *(ax.patch for ax in figure.axes)):
        patch.set_visible(False)
    buffer = io.StringIO()
    (width, height) = figure.get_size_inches()
    figure.dpi = 72
    vector = _ShortRenderer(72 * width, 72 * height, buffer, image_dpi=_DPI)
    renderer = _MIXED.MixedModeRenderer(figure, width, height, _DPI, vector)
    figure.draw(renderer)
    renderer.finalize()
    raw = buffer.getvalue()
    drawing = raw[raw.index("<svg") :]
    drawing = re.sub(
        r"-?\d+\.\d{3,}(?=[^<>]*>)", lambda m: f"{float(m[0]):.2f}", drawing
    )
    drawing = re.sub(r' transform="rotate\(-0 [^"]*"', "", drawing).replace(
        "xlink:href", "href"
    )
    mark = hashlib.sha1((label + drawing).encode(), usedforsecurity=False).hexdigest()[
        :8
    ]
    drawing = re.sub(r'(id="|href="#|url\(#)', rf"\1f{mark}", drawing)
    drawing = re.sub(r">\s+<", "><", drawing)
    box = drawing.split('viewBox="', 1)[1].split('"', 1)[0]
    head = f'<svg role="img" aria-label="{escape(label)}" viewBox="{box}">'
    return head + drawing[drawing.index(">") + 1 :].strip()
