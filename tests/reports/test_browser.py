"""Every page in a real browser: wide and narrow, light and dark, by mouse and by keyboard."""

import shutil
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import pytest

driver = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on the PATH"),
]

WIDTHS, SCHEMES = (1280, 400), ("light", "dark")
SIZES = "[document.documentElement.scrollWidth, document.documentElement.clientWidth]"
MOST_BYTES = 5_000_000


@pytest.fixture(scope="module")
def browser() -> Iterator["driver.Browser"]:
    with driver.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM)
        yield chromium
        chromium.close()


class Opened:
    """A page in the browser, with what it asked for and complained about."""

    def __init__(self, browser, file: Path, width: int, scheme: str) -> None:
        self.context = browser.new_context(
            viewport={"width": width, "height": 900},
            color_scheme=scheme,
            reduced_motion="reduce",
            offline=True,
        )
        self.page = self.context.new_page()
        self.said: list[str] = []
        self.asked: list[str] = []
        self.page.on("console", lambda message: self.said.append(message.text))
        self.page.on("pageerror", lambda error: self.said.append(str(error)))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(file.as_uri())

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.context.close()

    def unfold(self) -> None:
        self.page.evaluate("document.querySelectorAll('details').forEach(d => { d.open = true })")


@pytest.fixture(
    scope="module", params=list(product(WIDTHS, SCHEMES)), ids=lambda p: f"{p[0]}-{p[1]}"
)
def opened(request: pytest.FixtureRequest, browser, file: Path) -> Iterator[Opened]:
    with Opened(browser, file, *request.param) as page:
        yield page


@pytest.fixture(scope="module", params=WIDTHS)
def light(request: pytest.FixtureRequest, browser, file: Path) -> Iterator[Opened]:
    with Opened(browser, file, request.param, "light") as page:
        yield page


def test_page_opens_alone_and_without_complaint(opened, file):
    assert file.stat().st_size < MOST_BYTES
    opened.unfold()
    opened.page.wait_for_load_state("networkidle")
    assert [url for url in opened.asked if not url.startswith("data:")] == [file.as_uri()]
    assert opened.said == []


def test_page_is_no_wider_than_the_window(opened):
    opened.unfold()
    wide, window = opened.page.evaluate(SIZES)
    assert wide <= window
    outside = opened.page.evaluate(
        """() => [...document.querySelectorAll("h1, h2, h3, p, li, figure, .panel, .scroll, dl")]
          .filter((e) => e.checkVisibility() && !e.closest(".skip, .hidden"))
          .map((e) => [e.getBoundingClientRect(), e.outerHTML.slice(0, 80)])
          .filter(([box]) => box.left < -1 || box.right > innerWidth + 1)"""
    )
    assert outside == []


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
    opened.unfold()
    seen, poor = opened.page.evaluate(CONTRAST)
    assert seen > 20
    assert poor == {}


def test_contents_lead_to_their_sections(light):
    light.page.evaluate("document.querySelector('nav details').open = true")  # shut on a phone
    links = light.page.locator("nav a")
    assert links.count() > 0
    for k in range(links.count()):
        link = links.nth(k)
        name = link.get_attribute("href").removeprefix("#")
        link.click()
        assert light.page.evaluate("location.hash") == f"#{name}"
        heading = light.page.evaluate(
            """(id) => { const h = document.getElementById(id), r = h.getBoundingClientRect();
            const end = innerHeight + scrollY >= document.documentElement.scrollHeight - 2;
            return { level: h.tagName, text: h.textContent, top: r.top, end }; }""",
            name,
        )
        assert heading["level"] in ("H2", "H3")
        assert heading["text"].strip() == link.text_content().strip()
        assert -2 <= heading["top"] < (900 if heading["end"] else 60), heading


DRAWN = """() => {
  const quad = (text) => {
    const box = text.getBBox(), m = text.getScreenCTM(), trim = 0.2 * box.height;
    return [[box.x, box.y + trim], [box.x + box.width, box.y + trim],
            [box.x + box.width, box.y + box.height - trim], [box.x, box.y + box.height - trim]]
      .map(([x, y]) => [m.a * x + m.c * y + m.e, m.b * x + m.d * y + m.f]);
  };
  const apart = (a, b) => [a, b].some((corners) => corners.some((p, k) => {
    const q = corners[(k + 1) % 4], n = [q[1] - p[1], p[0] - q[0]];
    const along = (set) => set.map(([x, y]) => n[0] * x + n[1] * y);
    const [s, t] = [along(a), along(b)], slack = 0.5 * Math.hypot(...n);
    return Math.max(...s) < Math.min(...t) + slack || Math.max(...t) < Math.min(...s) + slack;
  }));
  const overlaps = [], outside = [], empty = [];
  let least = [99, ""], count = 0;
  const frameInk = new Set(  // none, white, grid and axes
    ["none", "rgb(255, 255, 255)", "rgb(228, 230, 232)", "rgb(138, 143, 148)"]);
  for (const svg of document.querySelectorAll("svg[role=img]")) {
    const label = svg.getAttribute("aria-label").slice(0, 60);
    const frame = svg.getBoundingClientRect();
    const texts = [...svg.querySelectorAll("text")].filter((t) => t.textContent.trim());
    const quads = texts.map(quad);
    count += texts.length;
    texts.forEach((t, i) => {
      const m = t.getScreenCTM();
      const size = parseFloat(getComputedStyle(t).fontSize) * Math.hypot(m.a, m.b);
      if (size < least[0]) least = [size, `${t.textContent} in ${label}`];
      if (quads[i].some(([x, y]) => x < frame.left - 1 || x > frame.right + 1 ||
          y < frame.top - 1 || y > frame.bottom + 1))
        outside.push(`${t.textContent} in ${label}`);
      for (let j = 0; j < i; j++)
        if (!apart(quads[i], quads[j]))
          overlaps.push(`${t.textContent} / ${texts[j].textContent} in ${label}`);
    });
    const marks = [...svg.querySelectorAll("path, use, image, line, rect, circle")].filter((e) => {
      if (e.closest("defs, clipPath")) return false;
      const s = getComputedStyle(e);
      return e.tagName === "image" || !frameInk.has(s.stroke) || !frameInk.has(s.fill);
    });
    if (!marks.length) empty.push(label);
  }
  return { overlaps, outside, empty, least, count };
}"""


def test_letters_of_drawings_are_legible_apart_and_inside(light):
    light.unfold()
    drawn = light.page.evaluate(DRAWN)
    assert drawn["least"][0] > 8.5, drawn["least"]
    assert drawn["overlaps"] == []
    assert drawn["outside"] == []
    assert drawn["empty"] == []


def test_tables_that_go_on_show_it(light):
    light.unfold()
    seen = light.page.evaluate(
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


def test_no_cell_is_a_ladder_of_words(light):
    light.unfold()
    ladders = light.page.evaluate(
        """() => [...document.querySelectorAll("td, tbody th")].filter((cell) => {
          const { width, height } = cell.getBoundingClientRect();
          const line = parseFloat(getComputedStyle(cell).lineHeight);
          const walker = document.createRange();
          walker.selectNodeContents(cell);
          return width < 100 && walker.getBoundingClientRect().height > 8 * line && height;
        }).map((cell) => cell.textContent.slice(0, 60))"""
    )
    assert ladders == []


def test_contents_are_shut_on_a_phone_only(browser, file):
    for width in WIDTHS:
        with Opened(browser, file, width, "light") as opened:
            shown = opened.page.evaluate("document.querySelector('nav details').open")
            assert shown == (width > 480)


def test_every_figure_shows_a_picture(light):
    light.unfold()
    sizes = light.page.evaluate(
        """async () => {
          for (const image of document.querySelectorAll("svg image")) {
            const picture = new Image();
            picture.src = image.getAttribute("href");
            await picture.decode();
          }
          return [...document.querySelectorAll("svg[role=img]")].map((e) => {
            const r = e.getBoundingClientRect();
            return [r.width, r.height, e.getAttribute("aria-label")];
          });
        }"""
    )
    assert [label for width, height, label in sizes if width <= 150 or height <= 50] == []
    assert light.page.locator(".enlarge").count() == len(sizes)


def test_drawing_opens_and_closes_by_mouse(light):
    drawings = light.page.locator(".panel > svg")
    if not drawings.count():
        assert light.page.locator("dialog[open], .enlarge").count() == 0
        return
    small = drawings.first.bounding_box()["width"]
    label = drawings.first.get_attribute("aria-label")
    drawings.first.click()
    large = light.page.locator("dialog[open] svg[role=img]")
    assert large.get_attribute("aria-label") == label
    assert large.bounding_box()["width"] > 1.3 * small
    assert light.page.locator("dialog .caption").text_content()
    light.page.get_by_role("button", name="Close").click()
    driver.expect(light.page.locator("dialog svg[role=img]")).to_have_count(0)
    assert light.page.locator("dialog[open]").count() == 0
    assert drawings.first.get_attribute("aria-label") == label
    assert drawings.first.bounding_box()["width"] == pytest.approx(small)
    assert light.said == []


def test_drawing_opens_and_closes_by_keyboard(light):
    buttons = light.page.locator(".enlarge")
    if not buttons.count():
        assert light.page.locator("svg[role=img]").count() == 0
        return
    labels = [d.get_attribute("aria-label") for d in light.page.locator(".panel > svg").all()]
    buttons.first.focus()
    light.page.keyboard.press("Enter")
    shown = light.page.locator("dialog[open] svg[role=img]")
    assert shown.get_attribute("aria-label") == labels[0]
    light.page.keyboard.press("ArrowRight")
    assert shown.get_attribute("aria-label") == labels[1 % len(labels)]
    light.page.keyboard.press("ArrowLeft")
    assert shown.get_attribute("aria-label") == labels[0]
    inside = (
        "document.activeElement === document.body || !!document.activeElement.closest('dialog')"
    )
    for _ in range(6):
        light.page.keyboard.press("Tab")
        assert light.page.evaluate(inside)
    light.page.keyboard.press("Escape")
    driver.expect(light.page.locator("dialog svg[role=img]")).to_have_count(0)
    assert light.page.locator("dialog[open]").count() == 0
    assert light.page.evaluate("document.activeElement.className") == "enlarge"


def test_paper_shows_all_in_light_colours(browser, file):
    with Opened(browser, file, 690, "dark") as opened:  # A4 within its margins
        opened.page.emulate_media(media="print", color_scheme="dark")
        opened.page.evaluate("dispatchEvent(new Event('beforeprint'))")
        wide, window = opened.page.evaluate(SIZES)
        assert wide <= window
        ground = opened.page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert ground == "rgb(255, 255, 255)"
        assert opened.page.locator(".enlarge:visible").count() == 0
        for table in opened.page.locator("table").all():
            assert table.bounding_box()["height"] > 20
        _, poor = opened.page.evaluate(CONTRAST)
        assert poor == {}
        opened.page.evaluate("dispatchEvent(new Event('afterprint'))")
        assert opened.page.locator("main details[open]").count() == 0
