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
