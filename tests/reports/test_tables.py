"""Tables as files hold what the page shows, in letters that spreadsheets and LaTeX read."""

import io
import re
from urllib.parse import unquote

import pandas as pd

from excitant.reports import page_of, save_run, table_files
from excitant.reports.page import Cell, Page, Section, Table, section
from excitant.reports.tables import csv_table, latex_table

HEADS = ("name:Joint", "number:Mass [kg]|given", "number:Mass [kg]|± std", "number:r²")
HEADS += ("number:nrmse", "text:Detail")
ROWS = (
    ("j_1", "−0.250", "6.3×10⁻⁵", "0.99", "12\u00a0%", "a & b: 5 → 4 N·m, “so”"),
    ("j_2", "–", "1.0", "–", ">\u00a0999\u00a0%", "x_1, y^2 {z} #3 ~ \\ $ 50 %"),
)
TABLE = Table(
    tuple((head.partition(":")[2], head.partition(":")[0]) for head in HEADS),
    tuple(tuple(map(Cell, row)) for row in ROWS),
)


def test_csv_has_plain_numbers_and_empty_cells_where_the_page_has_a_dash():
    found = pd.read_csv(io.StringIO(csv_table(TABLE)))
    assert list(found) == [
        "Joint",
        "Mass [kg], given",
        "Mass [kg], ± std",
        "r²",
        "nrmse [%]",
        "Detail",
    ]
    assert found["Mass [kg], given"].isna().tolist() == [False, True]
    assert found["Mass [kg], given"][0] == -0.25
    assert found["Mass [kg], ± std"].tolist() == [6.3e-5, 1.0]
    assert found["nrmse [%]"].tolist() == ["12", "> 999"]
    assert found["Detail"][1] == TABLE.rows[1][-1].text


def test_latex_is_escaped_and_aligned():
    written = latex_table(TABLE)
    assert written.isascii()
    assert written.startswith("\\begin{tabular}{lrrrrl}\n\\toprule\n")
    assert (
        r"j\_1 & $-$0.250 & 6.3$\cdot 10^{-5}$ & 0.99 & 12 & a \& b: 5 $\to$ 4 N$\cdot$m" in written
    )
    assert r"j\_2 &  & 1.0 &  & > 999 & x\_1, y\textasciicircum 2 \{z\} \#3" in written
    assert r"Mass [kg], $\pm$ std & r$^2$ & nrmse [\%]" in written


def test_every_table_of_every_page_is_written_whole(run):
    page = page_of(*run)
    tables = [table for _, _, table in page.tables()]
    for form, suffix in (("csv", ".csv"), ("latex", ".tex")):
        files = table_files(page, form)
        assert len(files) == len(tables)
        assert tables or page.title.startswith("Motion")
        for (name, content), table in zip(files.items(), tables, strict=True):
            assert re.fullmatch(rf"tables/[a-z0-9-]+\{suffix}", name)
            if form == "csv":
                found = pd.read_csv(io.StringIO(content), dtype=str, keep_default_na=False)
                assert found.shape == (len(table.rows), len(table.columns))
                continue
            assert content.isascii(), set(re.findall(r"[^\x00-\x7f]", content))
            body = re.sub(r"\\[a-z]+rule\n", "", content).splitlines()[1:-1]
            assert [len(re.findall(r"(?<!\\)&", line)) for line in body] == [
                len(table.columns) - 1
            ] * (1 + len(table.rows))
            assert not re.search(r"(?<!\\)[%#]", content)
            assert len(re.findall(r"(?<!\\)\$", content)) % 2 == 0


def test_tables_of_one_name_are_numbered():
    blocks = [TABLE, TABLE]
    page = Page("", "", (), (section("One", "", [("Part (a)", [*blocks]), ("Part", [TABLE])]),))
    assert list(table_files(page, "csv")) == [
        "tables/part-a.csv", "tables/part-a-2.csv", "tables/part.csv"
    ]  # fmt: skip
    several = Page("", "", (), (*page.sections, Section("Two", "", page.sections[0].parts[1:])))
    assert list(table_files(several, "latex"))[-1] == "tables/two-part.tex"


def test_command_writes_tables_that_the_page_leads_to(make, tmp_path, excitant, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("one", "two"):
        save_run(tmp_path / name, *make["identify"]())
    done = excitant("report one --tables csv")
    assert done.status == 0
    assert "one/tables/masses-and-centres-of-mass.csv" in done.out
    for folder, options in (("one", "one"), ("both", "one two -o both --tables latex")):
        assert excitant(f"report {options}").status == 0
        written = {f"tables/{path.name}" for path in (tmp_path / folder).glob("tables/*")}
        hrefs = re.findall('<a href="([^#"]+)"', (tmp_path / folder / "report.html").read_text())
        assert written
        assert written <= set(map(unquote, hrefs))
    save_run(tmp_path / "one", *make["identify"]())  # another run in its place
    assert not list((tmp_path / "one").glob("tables/*"))
