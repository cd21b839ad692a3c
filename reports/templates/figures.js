"use strict";
(() => {
  const root = document.documentElement;
  root.classList.add("drawn");
  const look = getComputedStyle(root);
  const ink = (name) => look.getPropertyValue(`--${name}`).trim();
  const make = (tag, attributes, text) => {
    const element = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
    element.textContent = text || "";
    return element;
  };
  const RAISED = { "-": "⁻", 0: "⁰", 1: "¹", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶", 7: "⁷", 8: "⁸", 9: "⁹" };
  const power = (k) => `10${[...String(k)].map((sign) => RAISED[sign]).join("")}`;
  const number = (x, digits = 6) => {
    const size = Math.abs(x);
    if (size < 1e-12) return "0";
    if (size >= 1e-3 && size < 1e5) return String(+x.toPrecision(digits)).replace("-", "−");
    const k = Math.floor(Math.log10(size) + 1e-9);
    return `${+(x / 10 ** k).toPrecision(3)}×${power(k)}`.replace("-", "−");
  };

  /* arrays are 16-bit steps in base64, of which the least is for a gap */
  const decoded = (array) => {
    const bytes = Uint8Array.from(atob(array.k), (sign) => sign.charCodeAt(0));
    const value = (k) => (k === -32768 ? null : array.low + array.step * (k + 32767));
    return Array.from(new Int16Array(bytes.buffer), value);
  };
  const grows = (x) => {
    let last = -Infinity;
    return x.every((value) => value === null || (value >= last && ((last = value), true)));
  };

  /* from values to pixels of the canvas */
  const placing = (plot, name) => {
    const { min, max, distr } = plot.scales[name];
    const { left, top, width, height } = plot.bbox;
    const along = distr === 3 ? Math.log10 : (x) => x;
    const [start, size] = name === "x" ? [left, width] : [top + height, -height];
    const low = along(min), span = along(max) - low;
    return (value) => start + ((along(value) - low) / span) * size;
  };
  const trace = (c, { x, y }, X, Y) => {
    let drawing = false;
    c.beginPath();
    x.forEach((value, k) => {
      if (value === null || y[k] === null) drawing = false;
      else if (drawing) c.lineTo(X(value), Y(y[k]));
      else { c.moveTo(X(value), Y(y[k])); drawing = true; }
    });
  };
  const stroke = (c, colour, width, dashed) => {
    const r = devicePixelRatio;
    c.strokeStyle = ink(colour);
    c.lineWidth = width * r;
    c.setLineDash(dashed ? [5 * r, 3 * r] : []);
    c.stroke();
  };
  const DRAW = {
    line(c, mark, X, Y) {
      trace(c, mark, X, Y);
      stroke(c, mark.colour, 1.2 * (mark.width || 1.1));
    },
    points(c, { x, y, colour, size = 4, style }, X, Y) {
      const radius = 0.62 * size * devicePixelRatio;
      c.fillStyle = ink(style === "hole" ? "paper" : colour);
      c.globalAlpha = style === "cloud" ? 0.4 : 1;
      x.forEach((value, k) => {
        if (value === null || y[k] === null) return;
        c.beginPath();
        c.arc(X(value), Y(y[k]), radius, 0, 2 * Math.PI);
        if (style !== "ring") c.fill();
        if (style === "ring" || style === "hole") stroke(c, colour, 1.2);
      });
    },
    band(c, { x, low, high, colour = "band" }, X, Y) {
      c.fillStyle = ink(colour);
      let start = 0;
      x.forEach((_, k) => {
        if (low[k] !== null && k < x.length - 1) return;
        const end = low[k] === null ? k : k + 1;
        c.beginPath();
        for (let i = start; i < end; i += 1) c.lineTo(X(x[i]), Y(low[i]));
        for (let i = end - 1; i >= start; i -= 1) c.lineTo(X(x[i]), Y(high[i]));
        c.fill();
        start = k + 1;
      });
    },
    span(c, { low, high, colour }, X, Y, box) {
      c.globalAlpha = 0.13;
      c.fillStyle = ink(colour);
      c.fillRect(box.left, Y(high), box.width, Y(low) - Y(high));
    },
    rule(c, { at, colour = "zero", along = "y", dashed }, X, Y, box) {
      c.beginPath();
      if (along === "x") { c.moveTo(X(at), box.top); c.lineTo(X(at), box.top + box.height); }
      else { c.moveTo(box.left, Y(at)); c.lineTo(box.left + box.width, Y(at)); }
      stroke(c, colour, dashed ? 1.2 : 0.8, dashed);
    },
  };
  const EDGE = 3;  // pixels by which marks may leave the frame
  const drawMarks = (plot, marks) => {
    const c = plot.ctx, box = plot.bbox;
    const [X, Y] = [placing(plot, "x"), placing(plot, "y")];
    c.save();
    c.beginPath();
    const edge = EDGE * devicePixelRatio;
    c.rect(box.left - edge, box.top - edge, box.width + 2 * edge, box.height + 2 * edge);
    c.clip();
    c.lineJoin = "round";
    for (const mark of marks) {
      c.globalAlpha = 1;
      DRAW[mark.kind](c, mark, X, Y, box);
    }
    c.restore();
  };

  /* what the marks have under the pointer, in words */
  const nearest = (x, at) => {
    let low = 0, high = x.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (x[middle] === null || x[middle] < at) low = middle;
      else high = middle;
    }
    return at - x[low] < x[high] - at ? low : high;
  };
  const REACH = 20;  // pixels
  const read = (plot, marks, left, top) => {
    const at = plot.posToVal(left, "x");
    const lines = [];
    let where = null;
    for (const mark of marks.filter((each) => each.name)) {
      const { x, y, kind, colour, name } = mark;
      if (kind === "line" && mark.grows) {
        const k = [0, 1, -1].map((step) => nearest(x, at) + step).find((i) => Number.isFinite(y[i]));
        if (k === undefined) continue;
        if (Math.abs(plot.valToPos(x[k], "x") - left) > REACH) continue;
        where ??= x[k];
        lines.push([colour, `${name} ${number(y[k], 4)}`]);
      } else if (kind === "points") {
        let best = REACH, found = -1;
        x.forEach((value, k) => {
          if (value === null || y[k] === null) return;
          const apart = Math.hypot(
            plot.valToPos(value, "x") - left, plot.valToPos(y[k], "y") - top);
          if (apart < best) [best, found] = [apart, k];
        });
        if (found < 0) continue;
        lines.push([colour, `${name} ${number(x[found], 4)}, ${number(y[found], 4)}`]);
      }
    }
    return [where, lines];
  };
  const showTip = (plot, tip, marks, label) => {
    const { left, top } = plot.cursor;
    const [where, lines] = left >= 0 ? read(plot, marks, left, Math.max(top, 0)) : [null, []];
    tip.hidden = !lines.length;
    if (tip.hidden) return;
    const head = where === null ? [] : [make("b", {}, `${label.replace(/ \[.*/, "")} ${number(where, 5)}`)];
    tip.replaceChildren(...head, ...lines.map(([colour, text]) => {
      const line = make("span", {}, text);
      line.style.setProperty("--key", `var(--${colour})`);
      return line;
    }));
    const right = left > plot.over.clientWidth / 2;
    tip.style.left = right ? "auto" : `${left + 10}px`;
    tip.style.right = right ? `${plot.over.clientWidth - left + 10}px` : "auto";
  };

  const decades = (low, high) => {
    const [first, last] = [Math.floor(Math.log10(low)), Math.ceil(Math.log10(high))];
    const steps = last - first > 3 ? [1] : [1, 2, 5];
    const every = Math.ceil((last - first) / 5);
    const ticks = [];
    for (let k = first; k <= last; k += 1)
      if (k % every === 0) ticks.push(...steps.map((step) => step * 10 ** k));
    return ticks.filter((x) => x >= low * 0.999 && x <= high * 1.001);
  };
  const written = (axis) => (x) => {
    if (axis.log) {
      const k = Math.round(Math.log10(x));
      return Math.abs(k) > 3 && Math.abs(x / 10 ** k - 1) < 1e-6 ? power(k) : String(+x.toPrecision(3));
    }
    const tick = axis.ticks.find(([at]) => at === x);
    return tick ? tick[1] : number(x);
  };
  const COUNTS = [1, 2, 5].flatMap((step) => [0, 1, 2, 3, 4].map((k) => step * 10 ** k));
  const axisOf = (axis, side, inner) => ({
    scale: side,
    label: axis.label || undefined, labelSize: 18, labelGap: 0, labelFont: "12px system-ui, sans-serif",
    font: "11.5px system-ui, sans-serif", gap: 4,
    space: side === "x" ? 48 : 22,
    size: (_, values) => {
      if (side === "x") return inner ? 4 : 22;
      return Math.max(44, 12 + 6.4 * Math.max(0, ...(values || []).map((text) => text.length)));
    },
    stroke: () => ink("soft"),
    grid: { stroke: () => ink("grid"), width: 1, show: side === "x" || !axis.ticks.length },
    ticks: { show: false },
    values: (_, splits) => splits.map(inner ? () => "" : written(axis)),
    ...(axis.whole ? { incrs: COUNTS.sort((a, b) => a - b) } : {}),
    ...(axis.log ? { splits: (_, i, low, high) => decades(low, high), filter: (_, splits) => splits } : {}),
    ...(axis.ticks.length ? { splits: () => axis.ticks.map(([at]) => at) } : {}),
  });

  /* one axes: a plot of uPlot, which draws axes, grid and cursor, with the marks on it */
  const plotOf = (host, spec, panel) => {
    const scale = ({ low, high, log }) => ({ time: false, auto: false, min: low, max: high, distr: log ? 3 : 1 });
    const inner = panel.shared && spec !== panel.specs.at(-1);
    const tip = make("div", { class: "tip" });
    tip.hidden = true;
    const view = (plot, x, y) => {
      plot.batch(() => {
        plot.setScale("x", { min: x[0], max: x[1] });
        plot.setScale("y", { min: y[0], max: y[1] });
      });
    };
    const whole = (plot) => view(plot, [spec.x.low, spec.x.high], [spec.y.low, spec.y.high]);
    const selected = (plot) => {
      const { left, top, width, height } = plot.select;
      if (width < 6 && height < 6) return;
      const [x0, x1] = [left, left + width].map((at) => plot.posToVal(at, "x"));
      const [y1, y0] = [top, top + height].map((at) => plot.posToVal(at, "y"));
      plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
      view(plot, [x0, x1], [y0, y1]);
    };
    const follow = (plot, name) => {
      if (name !== "x" || !panel.shared) return;
      const { min, max } = plot.scales.x;
      panel.plots.forEach(({ scales, setScale }) => {
        if (scales.x.min !== min || scales.x.max !== max) setScale("x", { min, max });
      });
    };
    const plot = new uPlot({
      width: panel.width(), height: panel.height(spec),
      padding: [8, spec.x.ticks.length ? 38 : 15, spec.x.label ? 0 : 4, 0],
      legend: { show: false },
      series: [{}],
      scales: { x: scale(spec.x), y: scale(spec.y) },
      axes: [axisOf(spec.x, "x", inner), axisOf(spec.y, "y")],
      cursor: {
        drag: { x: true, y: true, uni: 24, setScale: false }, points: { show: false }, y: false,
        sync: panel.shared && panel.specs.length > 1 ? { key: panel.key, scales: ["x", null], setSeries: false } : undefined,
        bind: { dblclick: (self) => () => { whole(self); return null; } },
      },
      hooks: {
        draw: [(self) => drawMarks(self, spec.marks)],
        setCursor: [(self) => showTip(self, tip, spec.marks, spec.x.label || "time")],
        setSelect: [selected], setScale: [follow],
      },
    }, [[spec.x.low, spec.x.high]], host);
    plot.over.append(tip);
    plot.whole = () => whole(plot);
    plot.look = (factor, shift) => {
      const ends = ({ min, max }, by) => {
        const half = (max - min) * factor / 2, middle = (min + max) / 2 + by * (max - min);
        return [middle - half, middle + half];
      };
      const { x, y } = plot.scales;
      view(plot, ends(x, shift), [y.min, y.max]);
    };
    return plot;
  };

  let count = 0;
  const panels = [];
  for (const source of document.querySelectorAll("script.figure")) {
    const figure = source.closest("figure");
    let content;
    const parsed = () => {
      if (content) return content;
      content = JSON.parse(source.textContent);
      const arrays = content.arrays.map(decoded);
      for (const { axes } of content.panels)
        for (const mark of axes.flatMap((each) => each.marks)) {
          for (const name of ["x", "y", "low", "high"])
            if (mark.kind !== "span" && name in mark) mark[name] = arrays[mark[name]];
          if (mark.kind === "line") mark.grows = grows(mark.x);
        }
      return content;
    };
    figure.querySelectorAll(".panel").forEach((element, k) => {
      const body = element.querySelector(".plots");
      const hosts = [...body.querySelectorAll(".plot")];
      const panel = {
        element, body, figure, plots: [], growth: 1, key: `panel ${(count += 1)}`,
        printed: 0,
        width: () => panel.printed || Math.max(body.clientWidth, 120),
        height: (spec) => Math.round(spec.height * panel.growth),
        draw: () => {
          if (panel.plots.length) return;
          const { axes, shared } = parsed().panels[k];
          Object.assign(panel, { specs: axes, shared });
          panel.plots = axes.map((spec, i) => plotOf(hosts[i], spec, panel));
          panel.size = `${panel.width()} ${panel.growth}`;
        },
        fit: () => {
          const size = `${panel.width()} ${panel.growth}`;
          if (size === panel.size) return;
          panel.size = size;
          panel.plots.forEach((plot, i) => {
            const spec = panel.specs[i];
            plot.setSize({ width: panel.width(), height: panel.height(spec) });
          });
        },
      };
      panels.push(panel);
    });
  }
  const ofBody = new Map(panels.map((panel) => [panel.body, panel]));
  const seen = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries) if (isIntersecting) ofBody.get(target).draw();
  }, { rootMargin: "400px" });
  const sized = new ResizeObserver((entries) => {
    for (const { target } of entries) if (target.clientWidth) ofBody.get(target).fit();
  });
  panels.forEach(({ body }) => { seen.observe(body); sized.observe(body); });
  const redraw = () => panels.forEach(({ plots }) => plots.forEach((plot) => plot.redraw(false, true)));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);

  /* one panel alone, with buttons to zoom */
  const button = (label, sign, act) => {
    const element = make("button", { type: "button", "aria-label": label, title: label }, sign);
    element.addEventListener("click", act);
    return element;
  };
  const dialog = make("dialog", { class: "zoom", "aria-labelledby": "zoom-title" });
  const title = make("p", { id: "zoom-title" });
  const stage = make("div", { class: "stage", tabindex: "0", role: "group", "aria-label": "Drawing" });
  const caption = make("p", { class: "caption" });
  const legend = make("div", {});
  const place = document.createComment("");
  let shown = -1;
  const all = (act) => () => panels[shown].plots.forEach(act);
  const bar = make("div", { class: "bar" });
  bar.append(
    title,
    button("Zoom in", "+", all((plot) => plot.look(0.5, 0))),
    button("Zoom out", "−", all((plot) => plot.look(2, 0))),
    button("Move left", "‹", all((plot) => plot.look(1, -0.5))),
    button("Move right", "›", all((plot) => plot.look(1, 0.5))),
    button("Whole", "↔", all((plot) => plot.whole())),
    button("Previous drawing", "←", () => show(shown - 1)),
    button("Next drawing", "→", () => show(shown + 1)),
    button("Close", "✕", () => dialog.close()),
  );
  const hint = "Drag over a stretch or a box to zoom in, double-click to see all; point or tap to read off.";
  dialog.append(bar, legend, stage, caption, make("p", { class: "caption" }, hint));
  const putBack = () => {
    if (shown < 0) return;
    const panel = panels[shown];
    panel.growth = 1;
    place.replaceWith(panel.body);
    panel.element.style.minHeight = "";
    panel.fit();
    shown = -1;
  };
  const partOf = (element) => {
    const above = [...document.querySelectorAll("h2, h3")].filter(
      (h) => h.compareDocumentPosition(element) & Node.DOCUMENT_POSITION_FOLLOWING,
    );
    return above.length ? above[above.length - 1].textContent : "Drawing";
  };
  const nameOf = ({ element }) => element.querySelector(".name")?.textContent || partOf(element);
  const show = (index) => {
    const next = (index + panels.length) % panels.length;
    putBack();
    shown = next;
    const panel = panels[shown];
    panel.draw();
    panel.element.style.minHeight = `${panel.element.offsetHeight}px`;
    title.textContent = nameOf(panel);
    caption.textContent = panel.figure.querySelector("figcaption").textContent;
    const keys = panel.figure.querySelector(".legend");
    legend.replaceChildren(...(keys ? [keys.cloneNode(true)] : []));
    panel.body.replaceWith(place);
    stage.replaceChildren(panel.body);
    if (!dialog.open) dialog.showModal();
    const total = panel.specs.reduce((sum, spec) => sum + spec.height, 0);
    panel.growth = Math.min(Math.max((innerHeight - 260) / total, 1), 3);
    panel.fit();
    stage.scrollTo(0, 0);
  };
  panels.forEach((panel, k) => {
    panel.element.prepend(button(`Enlarge: ${nameOf(panel)}`, "⤢", () => show(k)));
    panel.element.firstChild.className = "enlarge";
  });
  dialog.addEventListener("close", () => {
    const last = shown;
    putBack();
    if (last >= 0) panels[last].element.querySelector(".enlarge").focus();
  });
  dialog.addEventListener("click", (event) => event.target === dialog && dialog.close());
  dialog.addEventListener("keydown", ({ key }) => {
    if (key === "ArrowLeft") show(shown - 1);
    if (key === "ArrowRight") show(shown + 1);
  });
  if (panels.length) document.body.append(dialog);

  /* on paper all of them, light, and as wide as half of it */
  const PAPER = 316;
  addEventListener("beforeprint", () => {
    root.classList.add("paper");
    for (const panel of panels) {
      panel.printed = PAPER;
      panel.draw();
      panel.fit();
    }
    redraw();
  });
  addEventListener("afterprint", () => {
    root.classList.remove("paper");
    for (const panel of panels) {
      panel.printed = 0;
      panel.fit();
    }
    redraw();
  });
})();
