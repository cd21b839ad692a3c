"use strict";
(() => {
  const panels = [...document.querySelectorAll(".panel")];
  const make = (tag, attributes, text) => {
    const element = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
    element.textContent = text || "";
    return element;
  };
  const button = (label, sign) => make("button", { type: "button", "aria-label": label }, sign);

  const dialog = make("dialog", { class: "zoom", "aria-labelledby": "zoom-title" });
  const title = make("p", { id: "zoom-title" });
  const [previous, next, close] = [
    button("Previous drawing", "←"), button("Next drawing", "→"), button("Close", "✕"),
  ];
  const stage = make("div", { class: "stage", tabindex: "0", role: "group", "aria-label": "Drawing" });
  const caption = make("p", { class: "caption" });
  const bar = make("div", { class: "bar" });
  bar.append(title, previous, next, close);
  const legend = make("div", {});
  dialog.append(bar, legend, stage, caption);

  const place = document.createComment("");
  let shown = -1;
  const putBack = () => {
    if (shown < 0) return;
    place.replaceWith(stage.firstChild);
    panels[shown].style.minHeight = "";
    shown = -1;
  };
  const show = (index) => {
    putBack();
    shown = (index + panels.length) % panels.length;
    const panel = panels[shown];
    const figure = panel.closest("figure");
    const drawing = panel.querySelector("svg[role=img]");
    const heading = panel.querySelector("p");
    panel.style.minHeight = `${panel.offsetHeight}px`;
    title.textContent = heading ? heading.textContent : partOf(figure);
    caption.textContent = figure.querySelector("figcaption").textContent;
    const { width, height } = drawing.viewBox.baseVal;
    stage.style.setProperty("--ratio", width / height);
    drawing.replaceWith(place);
    stage.replaceChildren(drawing);
    const keys = figure.querySelector(".legend");
    legend.replaceChildren(...(keys ? [keys.cloneNode(true)] : []));
    stage.scrollTo(0, 0);
    if (!dialog.open) dialog.showModal();
  };
  const partOf = (element) => {
    const above = [...document.querySelectorAll("h2, h3")].filter(
      (h) => h.compareDocumentPosition(element) & Node.DOCUMENT_POSITION_FOLLOWING,
    );
    return above.length ? above[above.length - 1].textContent : "Drawing";
  };

  panels.forEach((panel, k) => {
    const heading = panel.querySelector("p");
    const name = heading ? heading.textContent : partOf(panel);
    const open = make("button", { type: "button", class: "enlarge", "aria-label": `Enlarge: ${name}` });
    open.textContent = "⤢";
    open.addEventListener("click", () => show(k));
    panel.querySelector("svg[role=img]").addEventListener("click", () => dialog.open || show(k));
    panel.prepend(open);
  });
  previous.addEventListener("click", () => show(shown - 1));
  next.addEventListener("click", () => show(shown + 1));
  close.addEventListener("click", () => dialog.close());
  dialog.addEventListener("close", putBack);
  dialog.addEventListener("click", (event) => event.target === dialog && dialog.close());
  dialog.addEventListener("keydown", ({ key }) => {
    if (key === "ArrowLeft") show(shown - 1);
    if (key === "ArrowRight") show(shown + 1);
  });
  if (panels.length) document.body.append(dialog);

  const decoded = (text, Numbers) =>
    Array.from(new Numbers(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer));
  const values = ({ low, step, k }) =>
    decoded(k, Int16Array).map((x) => (x === -32768 ? null : low + step * (x + 32767)));
  const sum = (a, b, sign) =>
    a.map((x, k) => (x === null || b[k] === null ? null : x + sign * b[k]));
  const digits = (x, n) => (x === null || x === undefined ? "–" : String(+x.toPrecision(n)));

  /* one joint of a figure at a time: chosen, zoomed into and read off */
  const timeline = (source) => {
    const { t, unit, names, curves, half } = JSON.parse(source.textContent);
    const figure = source.closest("figure");
    const time = decoded(t, Float32Array);
    const [start, end] = [time[0], time[time.length - 1]];
    const data = (joint) => {
      const lines = curves.map((each) => values(each.values[joint]));
      const left = lines.slice(1).map((line) => sum(lines[0], line, -1));
      const edges = half ? [1, -1].map((sign) => sum(lines.at(-1), values(half[joint]), sign)) : [];
      return [[time, ...edges, ...lines], [time, ...left]];
    };

    const chart = make("div", { class: "chart", role: "group", "aria-label": "One joint over time" });
    const choice = make("select", { "aria-label": "Joint" });
    [...names, "all joints"].forEach((name, k) => choice.append(new Option(name, k)));
    const bar = make("div", { class: "bar" });
    const range = make("output", {});
    const keys = make("span", {});
    bar.append(choice, keys, range);
    for (const [label, sign, shift, factor] of [
      ["Zoom in", "+", 0, 0.5], ["Zoom out", "−", 0, 2],
      ["Earlier", "←", -0.5, 1], ["Later", "→", 0.5, 1], ["Whole time", "↔", 0, Infinity],
    ]) {
      const press = button(label, sign);
      press.addEventListener("click", () => {
        const { min, max } = plots[0].scales.x;
        const width = Math.min((max - min) * factor, end - start);
        const first = (min + max - width) / 2 + shift * width;
        const from = Math.min(Math.max(first, start), end - width);
        plots[0].setScale("x", { min: from, max: from + width });
      });
      keys.append(press);
    }
    chart.append(bar);
    figure.querySelector(".panels").before(chart);

    const zoomed = (plot, scale) => {
      if (scale !== "x") return;
      const { min, max } = plot.scales.x;
      range.textContent = `${digits(min, 4)} to ${digits(max, 4)} s`;
      plots.forEach((each) => {
        const x = each.scales.x;
        if (x.min !== min || x.max !== max) each.setScale("x", { min, max });
      });
    };
    const draw = (label, height, lines, shown, bands = []) =>
      new uPlot({
        width: chart.clientWidth - 16, height, bands,
        cursor: { sync: { key: names.join(), scales: ["x", null] }, drag: { x: true, y: false } },
        scales: { x: { time: false } },
        axes: [{ label: "time [s]", labelSize: 18, size: 34 }, { label, labelSize: 18, size: 52 }],
        series: [{ label: "time [s]", value: (_, x) => digits(x, 5) }, ...lines],
        hooks: { setScale: [zoomed] },
      }, shown, chart);
    const line = ({ label, colour }) => ({
      label, stroke: colour, width: 1.3, points: { show: false }, value: (_, x) => digits(x, 4),
    });
    const edge = { label: "edge", class: "edge", stroke: "transparent", points: { show: false } };
    let plots = [];
    const begin = () => {
      const [torque, residual] = data(choice.selectedIndex % names.length);
      const band = half ? [{ series: [1, 2], fill: "#c3dcec" }] : [];
      plots = [
        draw(unit === "A" ? "current [A]" : `torque [${unit}]`, 300,
          [...(half ? [edge, edge] : []), ...curves.map(line)], torque, band),
        draw(`residual [${unit}]`, 210, curves.slice(1).map(line), residual),
      ];
      chart.append(make("p", {}, "Drag over a stretch to zoom in, double-click to see all; point or tap to read off."));
    };
    choice.addEventListener("change", () => {
      const all = choice.selectedIndex === names.length;
      figure.classList.toggle("all", all);
      if (all) return;
      const { min, max } = plots[0].scales.x;
      data(choice.selectedIndex).forEach((shown, k) => {
        plots[k].setData(shown, false);
        plots[k].setScale("x", { min, max });
      });
    });
    figure.classList.add("live");
    new ResizeObserver(() => {
      if (!chart.clientWidth) return;
      if (!plots.length) begin();
      else plots.forEach((each) => each.setSize({ width: chart.clientWidth - 16, height: each.height }));
    }).observe(chart);
  };
  document.querySelectorAll("script.timeline").forEach(timeline);

  const tables = [...document.querySelectorAll(".scroll")];
  const hint = (box) =>
    box.classList.toggle("more", box.scrollLeft + box.clientWidth < box.scrollWidth - 2);
  const watch = new ResizeObserver((seen) => seen.forEach(({ target }) => hint(target)));
  tables.forEach((box) => {
    watch.observe(box);
    box.addEventListener("scroll", () => hint(box), { passive: true });
  });

  const contents = document.querySelector("nav details");
  if (contents && matchMedia("screen and (max-width: 30rem)").matches) contents.open = false;

  const reveal = () => {
    const fold = document.getElementById(location.hash.slice(1))?.closest("details");
    if (fold) fold.open = true;
  };
  addEventListener("hashchange", reveal);
  document.querySelectorAll("nav a").forEach((a) => a.addEventListener("click", () => setTimeout(reveal)));
  reveal();

  const folded = () => [...document.querySelectorAll("details:not([open])")];
  let opened = [];
  addEventListener("beforeprint", () => (opened = folded()).forEach((each) => (each.open = true)));
  addEventListener("afterprint", () => opened.forEach((each) => (each.open = false)));

  const nav = document.querySelector("nav");
  const links = new Map([...document.querySelectorAll("nav a")].map((a) => [a.hash.slice(1), a]));
  const here = new IntersectionObserver(
    (entries) => {
      const entry = entries.find((each) => each.isIntersecting);
      if (!entry) return;
      links.forEach((link) => link.removeAttribute("aria-current"));
      const link = links.get(entry.target.id);
      link.setAttribute("aria-current", "location");
      if (nav.scrollHeight > nav.clientHeight) nav.scrollTop = link.offsetTop - nav.clientHeight / 2;
    },
    { rootMargin: "0px 0px -70% 0px" },
  );
  for (const id of links.keys()) {
    const heading = document.getElementById(id);
    if (heading) here.observe(heading);
  }
})();
