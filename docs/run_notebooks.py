"""Run the notebooks of the site and keep what they show: ``python docs/run_notebooks.py``."""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import os
import tempfile
from pathlib import Path
from typing import Any

NOTEBOOKS = sorted((Path(__file__).parent / "notebooks").glob("*.ipynb"))
_DPI = 100


def outputs_of(notebook: dict[str, Any]) -> list[list[dict[str, Any]]]:
    """What each code cell shows when all run in order in this folder, as a notebook has it."""
    import matplotlib.pyplot as plt

    plt.close("all")  # what others have left open
    names: dict[str, Any] = {"__name__": "__main__"}
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    return [_outputs("".join(cell["source"]), names) for cell in cells]


def _outputs(source: str, names: dict[str, Any]) -> list[dict[str, Any]]:
    import matplotlib.pyplot as plt

    tree, printed, shown = ast.parse(source), io.StringIO(), list[dict[str, Any]]()
    last = tree.body[-1]
    asked = isinstance(last, ast.Expr) and not source.rstrip().endswith(";")
    with contextlib.redirect_stdout(printed):
        exec(
            compile(
                ast.Module(tree.body[: len(tree.body) - asked], []), "cell", "exec"
            ),
            names,
        )
        value = (
            eval(compile(ast.Expression(last.value), "cell", "eval"), names)
            if asked
            else None
        )
    if printed.getvalue():
        text = printed.getvalue().splitlines(keepends=True)
        shown.append({"output_type": "stream", "name": "stdout", "text": text})
    if value is not None:
        shown.append(_output({"text/plain": repr(value), **_html(value)}))
    for number in plt.get_fignums():
        drawn = io.BytesIO()
        plt.figure(number).savefig(drawn, format="png", dpi=_DPI)
        picture = base64.b64encode(drawn.getvalue()).decode()
        shown.append(_output({"image/png": picture, "text/plain": "<Figure>"}))
    plt.close("all")
    return shown


def _html(value: Any) -> dict[str, str]:
    return {"text/html": value._repr_html_()} if hasattr(value, "_repr_html_") else {}


def _output(data: dict[str, str]) -> dict[str, Any]:
    return {"output_type": "display_data", "data": data, "metadata": {}}


def main() -> None:
    """Write every notebook anew with its outputs."""
    import matplotlib as mpl

    mpl.use("agg")
    for path in NOTEBOOKS:
        notebook = json.loads(path.read_text("utf-8"))
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
            found = iter(outputs_of(notebook))
        for number, cell in enumerate(notebook["cells"], start=1):
            if cell["cell_type"] == "code":
                cell |= {"outputs": next(found), "execution_count": None}
            cell["id"] = f"cell-{number}"
        text = json.dumps(notebook, indent=1, ensure_ascii=False, sort_keys=True)
        path.write_text(text + "\n", "utf-8")
        print(f"{path.name}: {os.path.getsize(path) / 1000:.0f} kB")


if __name__ == "__main__":
    main()
