// What a page shows in a browser, asked by test_browser.py.

const size = () => [document.documentElement.scrollWidth, document.documentElement.clientWidth];

const outside = (parts) => [...document.querySelectorAll(parts)]
  .filter((e) => e.checkVisibility() && !e.closest(".skip, .hidden"))
  .map((e) => [e.getBoundingClientRect(), e.outerHTML.slice(0, 80)])
  .filter(([box]) => box.left < -1 || box.right > innerWidth + 1);

const broken = () => {
  const broken = [], walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const seen = new Map();  // names of which a part is in each text between marks for a break
  while (walker.nextNode()) {
    const node = walker.currentNode, parent = node.parentElement;
    if (!parent.checkVisibility() || parent.closest("svg, script, style, .hidden")) continue;
    for (const { 0: word, index } of node.data.matchAll(/[\w.-]*_[\w.-]*/g)) {
      const range = document.createRange();
      range.setStart(node, index);
      range.setEnd(node, index + word.length);
      const lines = new Set([...range.getClientRects()].map((r) => Math.round(r.top)));
      seen.set(word, lines.size);
      if (lines.size > 1) broken.push(`${word} in ${parent.tagName} ${parent.className}`);
    }
    const before = node.previousSibling;
    if (before?.nodeName === "WBR") {
      const whole = parent.textContent.match(/\S+/g).find((w) => w.includes("_"));
      if (whole.length <= 24) broken.push(`${whole} may break`);
    }
  }
  return [seen.size, broken];
};

const contrast = () => {
  const parse = (text) => {
    const [r, g, b, a = 1] = text.match(/[\d.]+/g).map(Number);
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
};

const heading = () => {
  const h = document.querySelector(":target");
  const end = innerHeight + scrollY >= document.documentElement.scrollHeight - 2;
  return { level: h.tagName, text: h.textContent, top: h.getBoundingClientRect().top, end };
};

const inked = () => [...document.querySelectorAll(".plot canvas")].map((canvas) => {
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  const { width, height } = canvas.getBoundingClientRect();
  let inked = 0;
  for (let k = 3; k < data.length; k += 4) inked += data[k] > 128;
  return [width, height, inked / (data.length / 4)];
});

const tables = async () => {
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
};

const ladders = () => [...document.querySelectorAll("td, tbody th")].filter((cell) => {
  const { width, height } = cell.getBoundingClientRect();
  const line = parseFloat(getComputedStyle(cell).lineHeight);
  const walker = document.createRange();
  walker.selectNodeContents(cell);
  return width < 100 && walker.getBoundingClientRect().height > 8 * line && height;
}).map((cell) => cell.textContent.slice(0, 60));
