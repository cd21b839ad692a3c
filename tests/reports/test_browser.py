"""Every page in a real browser: wide and narrow, light and dark, by mouse and by keyboard."""

from collections.abc import Iterator
from pathlib import Path

import pytest

driver = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")

pytestmark = pytest.mark.slow

LOOKS = ((1200, "light"), (800, "light"), (400, "dark"))
SCREENS = 2  # of 900 pixels, before the first fold
SCRIPT = (Path(__file__).parent / "page.js").read_text("utf-8")


def asked(name: str) -> str:
    """A function of the script beside, as the browser runs it."""
    return f"(given) => {{ {SCRIPT}\nreturn {name}(given); }}"


class Opened:
    """A page in the browser, with what it asked for and complained about."""

    def __init__(self, browser, file: Path, width: int, scheme: str) -> None:
        look = {"color_scheme": scheme, "reduced_motion": "reduce", "offline": True}
        self.page = browser.new_page(viewport={"width": width, "height": 900}, **look)
        self.said, self.asked = [], []
        self.page.on("console", self._hear)
        self.page.on("pageerror", lambda error: self.said.append(str(error)))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(file.as_uri())
        self.contents = self.page.evaluate("document.querySelector('nav details').open")
        self.fold = self.page.evaluate(
            "document.querySelector('main details')?.getBoundingClientRect().top || 0"
        )

    def _hear(self, message) -> None:
        """What pages say; without a graphics card its driver says how slow it is."""
        if "GL Driver Message" not in message.text:
            self.said.append(message.text)

    def unfold(self) -> "Opened":
        """Scroll through all of the page, whose figures are drawn when they come into view."""
        self.page.evaluate("document.querySelectorAll('details').forEach(d => { d.open = true })")
        for panel in self.page.locator(".plots").all():
            panel.scroll_into_view_if_needed()
        driver.expect(self.page.locator(".plot:not(:has(canvas))")).to_have_count(0)
        return self


@pytest.fixture(scope="module", params=LOOKS)
def opened(request: pytest.FixtureRequest, browser, file: Path) -> Iterator[Opened]:
    yield (shown := Opened(browser, file, *request.param).unfold())
    shown.page.close()


def test_page_opens_alone_and_without_complaint(opened, file):
    opened.page.wait_for_load_state("networkidle")
    assert [url for url in opened.asked if not url.startswith("data:")] == [file.as_uri()]
    assert opened.said == []


def test_page_is_no_wider_than_the_window_and_what_matters_comes_first(opened):
    wide, window = opened.page.evaluate(asked("size"))
    assert wide <= window
    parts = "h1, h2, h3, p, li, figure, .panel, .scroll, dl"
    assert opened.page.evaluate(asked("outside"), parts) == []
    if opened.page.viewport_size["width"] == 1200:
        assert opened.fold <= SCREENS * 900


def test_no_name_is_broken_within_a_word_and_text_stands_out_from_its_ground(opened):
    seen, broken = opened.page.evaluate(asked("broken"))
    assert seen > 0 or "_" not in opened.page.locator("main").inner_text()
    assert broken == []
    seen, poor = opened.page.evaluate(asked("contrast"))
    assert seen > 20
    assert poor == {}


def test_contents_lead_to_their_sections_and_are_shut_on_a_phone(opened):
    assert opened.contents == (opened.page.viewport_size["width"] > 480)
    links = opened.page.locator("nav a").all()
    assert links
    for link in links:
        link.click()
        assert opened.page.evaluate("location.hash") == link.get_attribute("href")
        heading = opened.page.evaluate(asked("heading"))
        assert heading["level"] in ("H2", "H3")
        assert heading["text"].strip() == link.text_content().strip()
        assert -2 <= heading["top"] < (900 if heading["end"] else 60), heading


def test_every_figure_is_drawn_as_large_as_its_place(opened):
    for width, height, inked in opened.page.evaluate(asked("inked")):
        assert width > 200
        assert height > 60
        assert inked > 0.003
    panels = opened.page.locator(".panel")
    assert opened.page.locator(".enlarge").count() == panels.count()
    for panel in panels.all():
        canvas = panel.locator("canvas").first.bounding_box()
        assert canvas["width"] == pytest.approx(panel.bounding_box()["width"], abs=30)


def test_tables_that_go_on_show_it_and_no_cell_is_a_ladder_of_words(opened):
    seen = opened.page.evaluate(asked("tables"))
    assert all(goes_on == before and not after for goes_on, before, after in seen)
    assert opened.page.evaluate(asked("ladders")) == []


def test_drawing_opens_and_closes_by_mouse_and_keyboard(opened):
    page, drawings = opened.page, opened.page.locator(".panel .plots")
    large = page.locator("dialog[open] .plots")
    if not drawings.count():
        assert page.locator("dialog, .enlarge").count() == 0
        return
    small = drawings.first.locator("canvas").first.bounding_box()["height"]
    labels = [drawing.get_attribute("aria-label") for drawing in drawings.all()]

    def close(how):
        how()
        driver.expect(page.locator("dialog .plots")).to_have_count(0)
        assert page.locator("dialog[open]").count() == 0
        assert [drawing.get_attribute("aria-label") for drawing in drawings.all()] == labels

    page.locator(".enlarge").first.click()
    assert large.get_attribute("aria-label") == labels[0]
    width = large.locator("canvas").first.bounding_box()["width"]
    assert width > 0.8 * page.viewport_size["width"]
    assert page.locator("dialog .caption").first.text_content()
    close(page.get_by_role("button", name="Close").click)
    box = drawings.first.locator("canvas").first.bounding_box()
    assert box["height"] == pytest.approx(small, abs=1)

    page.locator(".enlarge").first.focus()
    for key, shown in (("Enter", 0), ("ArrowRight", 1 % len(labels)), ("ArrowLeft", 0)):
        page.keyboard.press(key)
        assert large.get_attribute("aria-label") == labels[shown]
    for _ in range(6):
        page.keyboard.press("Tab")
        assert page.locator(":is(header, nav, main, footer) :focus").count() == 0
    close(lambda: page.keyboard.press("Escape"))
    assert page.evaluate("document.activeElement.className") == "enlarge"
    assert opened.said == []


def test_paper_shows_all_in_light_colours(browser, file):
    page = Opened(browser, file, 690, "dark").page  # A4 within its margins
    page.emulate_media(media="print", color_scheme="dark")
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    wide, window = page.evaluate(asked("size"))
    assert wide <= window
    driver.expect(page.locator("body")).to_have_css("background-color", "rgb(255, 255, 255)")
    assert page.locator(".enlarge:visible").count() == 0
    driver.expect(page.locator(".plot:not(:has(canvas))")).to_have_count(0)
    assert all(width < 330 for width, *_ in page.evaluate(asked("inked")))
    tables = page.locator("table:not(.player table)").all()  # players do not move on paper
    assert all(table.bounding_box()["height"] > 20 for table in tables)
    _, poor = page.evaluate(asked("contrast"))
    assert poor == {}
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert page.locator("main details[open]").count() == 0
    page.close()


@pytest.mark.parametrize("width", [1200, 400])
@pytest.mark.parametrize("file", ["identify", "diagnose"], indirect=True)
def test_torque_over_time_is_read_off_and_zoomed_into(browser, file, width):
    opened = Opened(browser, file, width, "light").unfold()
    page = opened.page
    panel = page.locator(".panel", has=page.locator("[aria-label*='measured torque over time']"))
    plots = panel.first.locator(".u-over")
    tips = panel.first.locator(".tip:not([hidden])")

    def read(k, share):
        """Time, and the values by name, that the k-th axes show under the pointer."""
        plots.nth(k).scroll_into_view_if_needed()
        box = plots.nth(k).bounding_box()
        page.mouse.move(box["x"] + share * box["width"], box["y"] + 0.5 * box["height"])
        driver.expect(tips).to_have_count(2)
        shown = []
        for tip in tips.all():
            lines = tip.inner_text().replace("−", "-").splitlines()
            shown.append({name: float(x) for name, _, x in (x.rpartition(" ") for x in lines)})
        return shown

    torque, residual = read(0, 0.5)
    assert torque["time"] == residual["time"]
    measured = torque["measured"]
    for name in residual.keys() - {"time"}:
        assert residual[name] == pytest.approx(measured - torque[name], abs=2e-3 * abs(measured))
    start, middle, end = (read(0, share)[0]["time"] for share in (0.01, 0.5, 0.99))

    def drag(first, last, k=0):
        box = plots.nth(k).bounding_box()
        at = [box["x"] + share * box["width"] for share in (first, last)]
        page.mouse.move(at[0], box["y"] + 20)
        page.mouse.down()
        page.mouse.move(at[1], box["y"] + 22, steps=4)
        page.mouse.up()

    drag(0.25, 0.75)
    for k in (0, 1):  # the residual follows
        ends = [read(k, share)[k]["time"] for share in (0.01, 0.99)]
        assert ends[1] - ends[0] == pytest.approx((end - start) / 2, rel=0.05)
    plots.first.dblclick()
    assert read(0, 0.01)[0]["time"] == pytest.approx(start, abs=0.02 * (end - start))

    panel.first.locator(".enlarge").click()
    plots, tips = (page.locator(f"dialog {x}") for x in (".u-over", ".tip:not([hidden])"))
    for name, span in (("Zoom in", 0.5), ("Zoom out", 1.0), ("Zoom in", 0.5), ("Whole", 1.0)):
        page.get_by_role("button", name=name, exact=True).click()
        ends = [read(1, share)[1]["time"] for share in (0.01, 0.99)]
        assert ends[1] - ends[0] == pytest.approx(span * (end - start), rel=0.05)
    page.get_by_role("button", name="Move right").click()
    assert read(1, 0.01)[1]["time"] == pytest.approx(middle, abs=0.03 * (end - start))
    assert opened.said == []
    page.close()


@pytest.mark.parametrize("file", ["analyze"], indirect=True)
def test_without_a_script_figures_say_so(browser, file):
    page = browser.new_page(java_script_enabled=False)
    page.goto(file.as_uri())
    assert page.get_by_text("Figures are drawn where JavaScript is on.").count() == 1
    page.close()
