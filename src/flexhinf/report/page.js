"use strict";
(() => {
  const root = document.documentElement, all = (what, from = document) => [...from.querySelectorAll(what)];
  const nav = document.querySelector("nav"), menu = nav.querySelector(".menu"), here = nav.querySelector(".here");
  const folds = all("main details"), everything = nav.querySelector(".folds");
  const links = all("a", nav.querySelector("ol")), parts = links.map((link) => document.getElementById(link.hash.slice(1)));
  root.classList.add("js");

  // What a link points at is shown, folded or not.
  const reveal = (hash) => {
    const target = document.getElementById(decodeURIComponent(hash.slice(1)));
    if (!target) return;
    const own = target.querySelector(":scope > details");
    if (own) own.open = true;
    for (let fold = target.closest("details"); fold; fold = fold.parentElement.closest("details")) fold.open = true;
    target.scrollIntoView();
  };
  document.addEventListener("click", (event) => {
    const link = event.target.closest('a[href^="#"]');
    if (!link) return;
    nav.classList.remove("open");
    menu.setAttribute("aria-expanded", "false");
    reveal(link.hash);
  });
  addEventListener("hashchange", () => reveal(location.hash));
  if (location.hash) requestAnimationFrame(() => reveal(location.hash));

  // The contents mark the section that is read.
  let waiting = false, current = null;
  const mark = () => {
    waiting = false;
    const low = Math.max(120, innerHeight / 4);
    const end = scrollY > 0 && scrollY + innerHeight >= root.scrollHeight - 2;
    const seen = end ? parts.length - 1 : scrollY < 40 ? 0 : Math.max(0, parts.findLastIndex((part) => part.getBoundingClientRect().top < low));
    if (links[seen] === current) return;
    if (current) current.removeAttribute("aria-current");
    current = links[seen];
    current.setAttribute("aria-current", "true");
    here.textContent = current.textContent;
    const box = nav.getBoundingClientRect(), own = current.getBoundingClientRect();
    if (own.top < box.top || own.bottom > box.bottom) nav.scrollTop += own.top - box.top - nav.clientHeight / 2;
  };
  const later = () => { if (!waiting) { waiting = true; requestAnimationFrame(mark); } };
  addEventListener("scroll", later, { passive: true });
  addEventListener("resize", later);
  mark();

  menu.addEventListener("click", () => menu.setAttribute("aria-expanded", String(nav.classList.toggle("open"))));
  addEventListener("keydown", (event) => {
    if (event.key === "Escape" && nav.classList.contains("open")) menu.click();
  });

  // All folds at once.
  const label = () => { everything.textContent = folds.every((fold) => fold.open) ? "Close all" : "Open all"; };
  everything.addEventListener("click", () => {
    const open = !folds.every((fold) => fold.open);
    for (const fold of folds) fold.open = open;
  });
  for (const fold of folds) fold.addEventListener("toggle", () => { label(); scrollers(); later(); });
  // Paper has the first page alone, or with all folds open the whole report.
  const brief = (on) => document.documentElement.classList.toggle("brief", on && !folds.every((fold) => fold.open));
  addEventListener("beforeprint", () => brief(true));
  addEventListener("afterprint", () => brief(false));

  // What scrolls sideways can be reached with the keyboard.
  const scrollers = () => {
    for (const box of all(".table, .drawing, pre")) {
      if (box.scrollWidth > box.clientWidth + 1) box.tabIndex = 0; else box.removeAttribute("tabindex");
    }
  };
  addEventListener("resize", scrollers);
  scrollers();

  // The name of an option stays in one line.
  const walk = document.createTreeWalker(document.querySelector("main"), NodeFilter.SHOW_TEXT), texts = [];
  while (walk.nextNode()) if (/--[a-z]/.test(walk.currentNode.data)) texts.push(walk.currentNode);
  for (const text of texts.filter((each) => !each.parentElement.closest("svg, script, style"))) {
    text.replaceWith(...text.data.split(/(--[a-z][a-z-]*)/).map((part, k) => {
      const piece = document.createElement("span");
      piece.textContent = part;
      if (k % 2) piece.className = "option";
      return piece;
    }));
  }

  // A film: lines that move over a drawing, by a button or a slider. It lasts two seconds or longer.
  for (const figure of all("figure[data-film]")) {
    const { seconds, lines } = JSON.parse(figure.dataset.film), last = seconds.length - 1, whole = seconds[last] - seconds[0];
    const drawing = figure.querySelector("svg"), layer = document.createElementNS(drawing.namespaceURI, "g");
    const button = document.createElement("button"), slider = document.createElement("input"), clock = document.createElement("span");
    const slower = Math.max(1, 2 / whole), drawn = lines.map(([series]) => {
      const line = document.createElementNS(drawing.namespaceURI, "polyline");
      line.setAttribute("class", `series-${series}`);
      layer.append(line);
      return line;
    });
    layer.setAttribute("class", "film");
    drawing.append(layer);
    const show = (k) => {
      drawn.forEach((line, j) => line.setAttribute("points", lines[j][1][k].join(" ")));
      figure.classList.add("shown");
      slider.value = String(k);
      clock.textContent = `${seconds[k].toFixed(2)} s${slower > 1.05 ? `, ${slower.toPrecision(2)} times slower` : ""}`;
      slider.setAttribute("aria-valuetext", clock.textContent);
    };
    let begun = null; // when the film would have begun, ms; null while it stands
    const stop = () => { begun = null; button.textContent = "Play"; };
    const step = (now) => {
      if (begun === null) return;
      const passed = (now - begun) / 1e3 / slower, k = seconds.findLastIndex((t) => t - seconds[0] <= passed);
      show(Math.max(0, k));
      if (k >= last) stop(); else requestAnimationFrame(step);
    };
    button.addEventListener("click", () => {
      if (begun !== null) return stop();
      const from = Number(slider.value) >= last ? 0 : Number(slider.value);
      begun = performance.now() - 1e3 * slower * (seconds[from] - seconds[0]);
      button.textContent = "Pause";
      requestAnimationFrame(step);
    });
    slider.addEventListener("input", () => { stop(); show(Number(slider.value)); });
    Object.assign(button, { type: "button", textContent: "Play" });
    Object.assign(slider, { type: "range", min: "0", max: String(last), step: "1", value: String(last) });
    slider.setAttribute("aria-label", "Time in the move");
    clock.textContent = `moves for ${whole.toFixed(2)} s`;
    const player = document.createElement("div");
    player.className = "player";
    player.append(button, slider, clock);
    figure.querySelector("figcaption").before(player);
  }

  // A figure fills the window until it is clicked again or Escape is pressed.
  const large = document.querySelector("dialog.large"), stage = large.querySelector(".stage");
  let home = null;
  const enlarge = (figure) => {
    home = figure;
    const drawing = figure.querySelector("svg"), box = drawing.viewBox.baseVal;
    stage.style.setProperty("--ratio", String(box.width / box.height));
    stage.replaceChildren(drawing);
    large.showModal();
  };
  large.addEventListener("close", () => {
    home.querySelector(".drawing").append(stage.firstElementChild);
    home.querySelector(".enlarge").focus({ preventScroll: true });
  });
  large.addEventListener("click", () => large.close());
  for (const figure of all("figure")) {
    const name = figure.querySelector("figcaption strong"), button = document.createElement("button");
    button.type = "button";
    button.className = "enlarge";
    button.textContent = "Enlarge";
    button.setAttribute("aria-label", `Enlarge: ${name ? name.textContent : figure.id}`);
    figure.querySelector("figcaption").append(button);
    button.addEventListener("click", () => enlarge(figure));
    figure.querySelector(".drawing").addEventListener("click", () => enlarge(figure));
  }
})();
