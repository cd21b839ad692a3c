"""Every page in a real browser: wide and narrow, light and dark, by mouse and by keyboard."""

from collections.abc import Iterator
from pathlib import Path

import pytest

driver = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")

pytestmark = pytest.mark.slow

LOOKS = ((1200, "light"), (800, "light"), (400, "dark"))
SCREENS = 2  # of 900 pixels, before the first fold
SIZES = "[document.documentElement.scrollWidth, document.documentElement.clientWidth]"


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

    def unfolded(self) -> Iterator["Opened"]:
        self.page.evaluate("document.querySelectorAll('details').forEach(d => { d.open = true })")
        for choice in self.page.locator(".chart select").all():
            choice.select_option(label="all joints")
        yield self
        self.page.close()


@pytest.fixture(scope="module", params=LOOKS)
def opened(request: pytest.FixtureRequest, browser, file: Path) -> Iterator[Opened]:
    yield from Opened(browser, file, *request.param).unfolded()


def test_page_opens_alone_and_without_complaint(opened, file):
    opened.page.wait_for_load_state("networkidle")
    assert [url for url in opened.asked if not url.startswith("data:")] == [file.as_uri()]
    assert opened.said == []


def test_page_is_no_wider_than_the_window(opened):
    wide, window = opened.page.evaluate(SIZES)
    assert wide <= window
    outside = opened.page.evaluate(
        """() => [...document.querySelectorAll("h1, h2, h3, p, li, figure, .panel, .scroll, dl")]
          .filter((e) => e.checkVisibility() && !e.closest(".skip, .hidden"))
          .map((e) => [e.getBoundingClientRect(), e.outerHTML.slice(0, 80)])
          .filter(([box]) => box.left < -1 || box.right > innerWidth + 1)"""
    )
    assert outside == []


def test_what_matters_comes_before_the_first_fold(opened):
    if opened.page.viewport_size["width"] == 1200:
        assert opened.fold <= SCREENS * 900


BROKEN = """() => {
  const broken = [], walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const seen = new Map();  // names of which a part is in each text between marks for a break
  while (walker.nextNode()) {
    const node = walker.currentNode, parent = node.parentElement;
    if (!parent.checkVisibility() || parent.closest("svg, script, style, .hidden")) continue;
    for (const { 0: word, index } of node.data.matchAll(/[\\w.-]*_[\\w.-]*/g)) {
      const range = document.createRange();
      range.setStart(node, index);
      range.setEnd(node, index + word.length);
      const lines = new Set([...range.getClientRects()].map((r) => Math.round(r.top)));
      seen.set(word, lines.size);
      if (lines.size > 1) broken.push(`${word} in ${parent.tagName} ${parent.className}`);
    }
    const before = node.previousSibling;
    if (before?.nodeName === "WBR") {
      const whole = parent.textContent.match(/\\S+/g).find((w) => w.includes("_"));
      if (whole.length <= 24) broken.push(`${whole} may break`);
    }
  }
  return [seen.size, broken];
}"""


def test_no_name_is_broken_within_a_word(opened):
    seen, broken = opened.page.evaluate(BROKEN)
    assert seen > 0 or "_" not in opened.page.locator("main").inner_text()
    assert broken == []


CONTRAST = """() => {
  const parse = (text) => {
    const [r, g, b, a = 1] = text.match(/[\\d.]+/g).map(Number);
    return { c: [r, g, b], a };
  };
  const over = (top, under) => top.c.map((x, k) => top.a * x + (1 - top.a) * under[k]);
  const shade = (c) => c.map((x) => x / 255)
    .map((x) => (x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4))
    .reduce((sum, x, k) => sum + x * [0.2126, 0.7152, 0.0722][k], 0);
  const ground = (element) => {
    const layers = [];
    for (let e = element; e; e = e.parentElement) {
      const colour = parse(getComputedStyle(e).backgroundColor);
      layers.push(colour);
      if (colour.a === 1) break;
    }
    return layers.reverse().reduce((under, top) => over(top, under), [255, 255, 255]);
  };
  const poor = new Map();
  let seen = 0;
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const text = walker.currentNode.data.trim(), element = walker.currentNode.parentElement;
    if (!text || !element.checkVisibility({ visibilityProperty: true }) ||
        element.closest("script, style")) continue;
    seen += 1;
    const style = getComputedStyle(element), drawn = element instanceof SVGElement;
    const under = ground(drawn ? element.closest("svg").parentElement : element);
    const ink = over(parse(drawn ? style.fill : style.color), under);
    const [low, high] = [shade(ink), shade(under)].sort((x, y) => x - y);
    const ratio = (high + 0.05) / (low + 0.05);
    const pair = `${element.tagName} ${ink.map(Math.round)} on ${under.map(Math.round)}`;
    if (ratio < 4.5) poor.set(pair, `${ratio.toFixed(2)}: ${text.slice(0, 40)}`);
  }
  return [seen, Object.fromEntries(poor)];
}"""


def test_text_stands_out_from_its_ground(opened):
    seen, poor = opened.page.evaluate(CONTRAST)
    assert seen > 20
    assert poor == {}


def test_contents_lead_to_their_sections_and_are_shut_on_a_phone(opened):
    assert opened.contents == (opened.page.viewport_size["width"] > 480)
    links = opened.page.locator("nav a")
    assert links.count() > 0
    for k in range(links.count()):
        link = links.nth(k)
        link.click()
        assert opened.page.evaluate("location.hash") == link.get_attribute("href")
        heading = opened.page.evaluate(
            """() => { const h = document.querySelector(":target");
            const end = innerHeight + scrollY >= document.documentElement.scrollHeight - 2;
            return { level: h.tagName, text: h.textContent, top: h.getBoundingClientRect().top,
                     end }; }"""
        )
        assert heading["level"] in ("H2", "H3")
        assert heading["text"].strip() == link.text_content().strip()
        assert -2 <= heading["top"] < (900 if heading["end"] else 60), heading


DRAWN = """async () => {
  const boxOf = (text) => {  // of level or upright letters, without the room above and below them
    const r = text.getBoundingClientRect(), level = Math.abs(text.getScreenCTM().b) < 1e-6;
    const [x, y] = level ? [0, 0.2 * r.height] : [0.2 * r.width, 0];
    return [r.left + x, r.top + y, r.right - x, r.bottom - y];
  };
  const apart = (a, b) => [0, 1].some(
    (k) => a[k + 2] < b[k] + 0.5 || b[k + 2] < a[k] + 0.5);
  const overlaps = [], outside = [], empty = [], small = [];
  let least = [99, ""];
  for (const image of document.querySelectorAll("svg image")) {
    const picture = new Image();
    picture.src = image.getAttribute("href");
    await picture.decode();
  }
  const frameInk = new Set(  // none, white, grid and axes
    ["none", "rgb(255, 255, 255)", "rgb(228, 230, 232)", "rgb(138, 143, 148)"]);
  for (const svg of document.querySelectorAll("svg[role=img]")) {
    const label = svg.getAttribute("aria-label").slice(0, 60);
    const frame = svg.getBoundingClientRect();
    const texts = [...svg.querySelectorAll("text")].filter((t) => t.textContent.trim());
    const boxes = texts.map(boxOf);
    texts.forEach((t, i) => {
      const m = t.getScreenCTM();
      const size = parseFloat(getComputedStyle(t).fontSize) * Math.hypot(m.a, m.b);
      if (size < least[0]) least = [size, `${t.textContent} in ${label}`];
      const [left, top, right, bottom] = boxes[i];
      if (left < frame.left - 1 || right > frame.right + 1 ||
          top < frame.top - 1 || bottom > frame.bottom + 1)
        outside.push(`${t.textContent} in ${label}`);
      for (let j = 0; j < i; j++)
        if (!apart(boxes[i], boxes[j]))
          overlaps.push(`${t.textContent} / ${texts[j].textContent} in ${label}`);
    });
    const marks = [...svg.querySelectorAll("path, use, image, line, rect, circle")].filter((e) => {
      if (e.closest("defs, clipPath")) return false;
      const s = getComputedStyle(e);
      return e.tagName === "image" || !frameInk.has(s.stroke) || !frameInk.has(s.fill);
    });
    if (!marks.length) empty.push(label);
    if (frame.width <= 150 || frame.height <= 50) small.push(label);
  }
  return { overlaps, outside, empty, small, least };
}"""


def test_drawings_show_something_in_letters_that_are_legible_apart_and_inside(opened):
    drawn = opened.page.evaluate(DRAWN)
    assert drawn.pop("least")[0] > 8.5
    assert drawn == {"overlaps": [], "outside": [], "empty": [], "small": []}
    drawings = opened.page.locator("svg[role=img]").count()
    assert opened.page.locator(".enlarge").count() == drawings


def test_tables_that_go_on_show_it(opened):
    seen = opened.page.evaluate(
        """async () => {
          const found = [];
          const settled = async (box, wanted) => {  // observers speak with the next frame
            for (let k = 0; k < 40 && box.classList.contains("more") !== wanted; k += 1)
              await new Promise((done) => setTimeout(done, 50));
            return box.classList.contains("more");
          };
          for (const box of document.querySelectorAll(".scroll")) {
            const goesOn = box.scrollWidth > box.clientWidth + 2;
            const before = await settled(box, goesOn);
            box.scrollLeft = box.scrollWidth;
            found.push([goesOn, before, await settled(box, false)]);
            box.scrollLeft = 0;
          }
          return found;
        }"""
    )
    assert all(goes_on == before and not after for goes_on, before, after in seen)


def test_no_cell_is_a_ladder_of_words(opened):
    ladders = opened.page.evaluate(
        """() => [...document.querySelectorAll("td, tbody th")].filter((cell) => {
          const { width, height } = cell.getBoundingClientRect();
          const line = parseFloat(getComputedStyle(cell).lineHeight);
          const walker = document.createRange();
          walker.selectNodeContents(cell);
          return width < 100 && walker.getBoundingClientRect().height > 8 * line && height;
        }).map((cell) => cell.textContent.slice(0, 60))"""
    )
    assert ladders == []


def test_drawing_opens_and_closes_by_mouse_and_keyboard(opened):
    page, drawings = opened.page, opened.page.locator(".panel > svg")
    large = page.locator("dialog[open] svg[role=img]")
    if not drawings.count():
        assert page.locator("dialog[open], .enlarge, svg[role=img]").count() == 0
        return
    small = drawings.first.bounding_box()["width"]
    labels = [drawing.get_attribute("aria-label") for drawing in drawings.all()]

    def close(how):
        how()
        driver.expect(page.locator("dialog svg[role=img]")).to_have_count(0)
        assert page.locator("dialog[open]").count() == 0
        assert [drawing.get_attribute("aria-label") for drawing in drawings.all()] == labels

    drawings.first.click()
    assert large.get_attribute("aria-label") == labels[0]
    assert large.bounding_box()["width"] > 1.3 * small
    assert page.locator("dialog .caption").text_content()
    close(page.get_by_role("button", name="Close").click)
    assert drawings.first.bounding_box()["width"] == pytest.approx(small)

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
    wide, window = page.evaluate(SIZES)
    assert wide <= window
    driver.expect(page.locator("body")).to_have_css("background-color", "rgb(255, 255, 255)")
    assert page.locator(".enlarge:visible").count() == 0
    tables = page.locator("table:not(.player table)").all()  # players do not move on paper
    assert all(table.bounding_box()["height"] > 20 for table in tables)
    _, poor = page.evaluate(CONTRAST)
    assert poor == {}
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert page.locator("main details[open]").count() == 0
    page.close()


@pytest.fixture(params=["identify", "diagnose"])
def timed(request, written, tmp_path) -> Path:
    path = tmp_path / "report.html"
    path.write_text(written(request.param).source, "utf-8")
    return path


@pytest.mark.parametrize("width", [1200, 400])
def test_torque_over_time_is_chosen_zoomed_into_and_read_off(browser, timed, width):
    opened = Opened(browser, timed, width, "light")
    page = opened.page
    page.evaluate("document.querySelectorAll('details').forEach(d => { d.open = true })")
    chart, panels = page.locator(".chart"), page.locator("figure.live .panel:visible")
    span, value = chart.locator("output"), chart.locator(".u-series:not(.edge) .u-value")
    whole = span.text_content()
    assert panels.count() == 0
    assert chart.locator("canvas").count() == 2  # torque, and below it the residual

    plot = chart.locator(".u-over").first
    plot.scroll_into_view_if_needed()
    box = plot.bounding_box()
    at = [(box["x"] + share * box["width"], box["y"] + 40) for share in (0.25, 0.5)]
    page.mouse.move(*at[0])
    driver.expect(value.first).not_to_have_text("–")
    t, measured, *models = (float(x) for x in value.all_text_contents()[: value.count() // 2 + 1])
    start, end = (float(x) for x in whole.removesuffix(" s").split(" to "))
    assert t == pytest.approx(start + 0.25 * (end - start), abs=0.02 * (end - start))
    residuals = [float(x) for x in value.all_text_contents()[len(models) + 3 :]]
    assert residuals == pytest.approx([measured - x for x in models], abs=2e-3 * abs(measured))

    page.mouse.down()
    page.mouse.move(*at[1], steps=4)
    page.mouse.up()
    low, high = (float(x) for x in span.text_content().removesuffix(" s").split(" to "))
    quarter = (end - start) / 4
    assert [low - start, high - low] == pytest.approx([quarter, quarter], abs=0.1 * quarter)

    def residuals_follow():
        below = chart.locator(".u-over").nth(1).bounding_box()
        page.mouse.move(below["x"] + 0.5 * below["width"], below["y"] + 20)
        first, last = (float(x) for x in span.text_content().removesuffix(" s").split(" to "))
        middle = float(value.nth(len(models) + 2).text_content())
        assert middle == pytest.approx((first + last) / 2, abs=0.05 * (last - first))

    residuals_follow()
    chart.locator("select").select_option(index=1)
    assert span.text_content() == f"{low:.4g} to {high:.4g} s"
    page.mouse.move(at[0][0] + 5, at[0][1])
    driver.expect(value.nth(1)).not_to_have_text(f"{measured:.4g}")
    for name in ("Zoom out", "Zoom in", "Later", "Earlier", "Whole time"):
        before = span.text_content()
        page.get_by_role("button", name=name).click()
        assert span.text_content() != before
        residuals_follow()
    assert span.text_content() == whole

    chart.locator("select").select_option(label="all joints")
    names = chart.locator("option").all_text_contents()[:-1]
    assert panels.locator("p").all_text_contents() == names
    assert not chart.locator("canvas").first.is_visible()
    page.emulate_media(media="print")
    assert not chart.is_visible()
    assert opened.said == []
    page.close()


def test_torque_over_time_is_drawn_without_a_script(browser, timed):
    page = browser.new_page(java_script_enabled=False)
    page.goto(timed.as_uri())
    figure = page.locator("figure:has(script.timeline)")
    figure.locator("xpath=ancestor::details/summary").click()
    assert figure.locator(".panel svg[role=img]").first.is_visible()
    assert page.locator(".chart").count() == 0
    page.close()
