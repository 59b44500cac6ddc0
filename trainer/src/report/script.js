// The pictures answer. Where a dot is pointed at or reached by an arrow key, a box shows what the table of poses says of
// it, and the pose is marked in every other plot; dragging marks all poses of a part of a plot. Nothing of the page depends
// on this script: every word and number stands in it without.
(() => {
  "use strict";

  // The table: a row for each pose, in the order of the dots.
  const table = document.getElementById("poses");
  const heads = Array.from(table.tHead.rows[0].cells);
  const rows = Array.from(table.tBodies[0].rows);
  const column = (role) => heads.findIndex((head) => head.dataset.role === role);
  const text = (pose, i) => rows[pose].cells[i].textContent.trim();

  const near = 16; // pixels from a dot that still mean it
  const drag = 6; // units of a drawing that are no click any more

  let current = -1; // the pose that is shown
  let marked = null; // the poses that are marked
  let shownIn = null; // the plot with the box

  const element = (name, className, parent) => {
    const made = document.createElement(name);
    made.className = className;
    parent.append(made);
    return made;
  };
  const tip = element("div", "tip", document.body);
  tip.setAttribute("aria-hidden", "true");
  tip.hidden = true;
  // The same for screen readers, where keys were pressed.
  const said = element("div", "said", document.body);
  said.setAttribute("role", "status");
  const panel = element("div", "panel", document.body);
  panel.hidden = true;
  const summary = element("span", "", panel);
  summary.setAttribute("role", "status");
  const clear = element("button", "", panel);
  clear.type = "button";
  clear.textContent = "Clear";

  // "error (mm)" is a name and a unit.
  const named = (label) => {
    const parts = label.match(/^(.*) \((.*)\)$/);
    return parts === null ? [label, ""] : [parts[1], " " + parts[2]];
  };

  // What is said of a pose: what it is called, a line each, and pairs of name and value.
  const titles = (pose) => {
    const parts = Array.from(rows[pose].cells[0].children, (part) => part.textContent.trim());
    return parts.length > 0 ? parts : [text(pose, 0)];
  };
  const values = (pose) => {
    const [joints, units, pairs] = [[], new Set(), []];
    heads.forEach((head, i) => {
      const value = text(pose, i);
      if (i === 0 || value === "") return;
      const [name, unit] = named(head.textContent);
      if (head.dataset.role !== "joint") return void pairs.push([name, value + unit]);
      joints.push([value, unit]);
      units.add(unit);
    });
    const all = units.size === 1 ? joints.map((joint) => joint[0]).join(", ") + joints[0][1] : joints.map((joint) => joint.join("")).join(", ");
    return joints.length > 0 ? pairs.concat([["joints", all]]) : pairs;
  };

  // A copy of a path that draws marks of another class.
  const copy = (path, className, before) => {
    const made = path.cloneNode(false);
    made.removeAttribute("data-poses");
    made.setAttribute("class", className);
    made.setAttribute("d", "");
    path.parentNode.insertBefore(made, before);
    return made;
  };

  const plots = Array.from(document.querySelectorAll("svg[data-plane]"), (svg) => {
    const series = Array.from(svg.querySelectorAll("path[data-poses]"), (path) => {
      const named = path.dataset.poses === "" ? [] : path.dataset.poses.split(" ").map(Number);
      const dots = path.getAttribute("d").split("M").slice(1).map((d, i) => {
        const [x, y] = d.split("h")[0].split(" ").map(Number);
        return { pose: named.length > 0 ? named[i] : i, x, y };
      });
      return { path, dots };
    });
    const dots = series.flatMap((one) => one.dots);
    // Arrow keys go through the poses by x.
    const places = new Map();
    for (const dot of dots) if (!places.has(dot.pose)) places.set(dot.pose, dot);
    const order = Array.from(places.keys()).sort((a, b) => places.get(a).x - places.get(b).x || a - b);
    const [left, top, width, height] = svg.dataset.plane.split(" ").map(Number);
    const label = Array.from(svg.querySelectorAll("text.label")).pop().textContent;
    const plot = { svg, series, dots, places, order, left, top, width, height, label, begin: -1 };
    plot.ends = svg.dataset.x.split(" ").map(Number);
    plot.rectangle = svg.dataset.brush === "rectangle";
    const last = svg.lastElementChild;
    plot.band = copy(series[0].path, "band", series[0].path);
    for (const one of series) one.marks = copy(one.path, "marked " + one.path.getAttribute("class"), last);
    plot.halo = copy(series[0].path, "halo", last);
    for (const one of series) one.core = copy(one.path, "core " + one.path.getAttribute("class"), last);
    svg.setAttribute("tabindex", "0");
    svg.setAttribute("role", "application");
    const name = svg.getAttribute("aria-label");
    svg.setAttribute("aria-label", name + ". Arrow keys go through its " + order.length + " poses; with Shift they mark them.");
    return plot;
  });

  const path = (dots, wanted) => dots.filter(wanted).map((dot) => "M" + dot.x + " " + dot.y + "h0").join("");

  const draw = () => {
    const isCurrent = (dot) => dot.pose === current;
    const isMarked = (dot) => marked !== null ? marked.has(dot.pose) : false;
    for (const plot of plots) {
      plot.svg.classList.toggle("brushed", marked !== null);
      plot.halo.setAttribute("d", path(plot.dots, isCurrent));
      for (const one of plot.series) {
        one.marks.setAttribute("d", path(one.dots, isMarked));
        one.core.setAttribute("d", path(one.dots, isCurrent));
      }
    }
  };

  // The box stands above its dot or, without room, below it.
  const place = () => {
    if (tip.hidden) return;
    const dot = shownIn.places.get(current);
    const box = shownIn.svg.getBoundingClientRect();
    const scale = box.width / shownIn.svg.viewBox.baseVal.width;
    const [x, y] = [box.left + scale * dot.x, box.top + scale * dot.y];
    const page = document.documentElement;
    const most = page.clientWidth - tip.offsetWidth - 8;
    tip.style.left = Math.max(8, Math.min(x - tip.offsetWidth / 2, most)) + "px";
    const above = y - tip.offsetHeight - 12;
    tip.style.top = (above > 4 ? above : y + 14) + "px";
  };

  const show = (plot, pose) => {
    if (pose === current) if (plot === shownIn) return;
    [shownIn, current] = [plot, pose];
    tip.hidden = pose < 0;
    if (pose >= 0) {
      tip.replaceChildren();
      titles(pose).forEach((line, i) => { element(i === 0 ? "b" : "p", "", tip).textContent = line; });
      for (const pair of values(pose)) pair.forEach((part, i) => { element("span", i === 0 ? "name" : "", tip).textContent = part; });
    }
    draw();
    place();
  };

  const speak = (pose) => {
    said.textContent = titles(pose).concat(values(pose).map((pair) => pair.join(": "))).join("; ");
  };

  const rounded = (value, span) => value.toFixed(span >= 20 ? 0 : span >= 2 ? 1 : 3);

  // Marks the poses between two places of a plot.
  const mark = (plot, from, to) => {
    const [x0, x1] = [Math.min(from.x, to.x), Math.max(from.x, to.x)].map((x) => Math.min(Math.max(x, plot.left), plot.left + plot.width));
    let [y0, y1] = [plot.top, plot.top + plot.height];
    if (plot.rectangle) [y0, y1] = [Math.min(from.y, to.y), Math.max(from.y, to.y)];
    const inside = (dot) => {
      if (dot.x < x0 - 0.05 || dot.x > x1 + 0.05) return false;
      return plot.rectangle ? dot.y >= y0 - 0.05 ? dot.y <= y1 + 0.05 : false : true;
    };
    marked = new Set(plot.dots.filter(inside).map((dot) => dot.pose));
    for (const other of plots) other.band.setAttribute("d", "");
    plot.band.setAttribute("d", "M" + x0 + " " + y0 + "H" + x1 + "V" + y1 + "H" + x0 + "z");
    const error = column("error");
    const value = (pose) => Number(text(pose, error));
    const mean = (poses) => (poses.reduce((sum, pose) => sum + value(pose), 0) / poses.length).toFixed(3);
    const others = rows.map((_, pose) => pose).filter((pose) => !marked.has(pose));
    const [low, high] = plot.ends;
    const at = (x) => rounded(low + (high - low) * (x - plot.left) / plot.width, high - low);
    let found = marked.size + " of " + rows.length + " poses are marked";
    const [name, unit] = named(plot.label);
    if (!plot.rectangle) found += ": " + name + " from " + at(x0) + " to " + at(x1) + unit;
    const [what, length] = named(heads[error].textContent);
    if (marked.size > 0) found += ". Mean " + what + " " + mean(Array.from(marked)) + length;
    if (marked.size > 0) if (others.length > 0) found += ", of the others " + mean(others) + length;
    summary.textContent = found + ".";
    panel.hidden = false;
    draw();
  };

  const clearMarks = () => {
    marked = null;
    panel.hidden = true;
    for (const plot of plots) {
      plot.begin = -1;
      plot.band.setAttribute("d", "");
    }
    draw();
  };
  clear.addEventListener("click", clearMarks);

  const step = (plot, key) => {
    const end = plot.order.length - 1;
    const at = plot.order.indexOf(current);
    const page = Math.max(1, Math.round(end / 10));
    const to = { ArrowRight: at + 1, ArrowUp: at + 1, ArrowLeft: at - 1, ArrowDown: at - 1, PageUp: at + page, PageDown: at - page, Home: 0, End: end }[key];
    return to === undefined ? -1 : Math.min(Math.max(to, 0), end);
  };

  for (const plot of plots) {
    const svg = plot.svg;
    const at = (event) => {
      const box = svg.getBoundingClientRect();
      const scale = svg.viewBox.baseVal.width / box.width;
      return { x: (event.clientX - box.left) * scale, y: (event.clientY - box.top) * scale, scale };
    };
    const nearest = (point) => {
      const away = (dot) => Math.hypot(dot.x - point.x, dot.y - point.y);
      const best = plot.dots.reduce((a, b) => (away(b) < away(a) ? b : a));
      return away(best) < near * point.scale ? best.pose : -1;
    };
    let from = null;
    let dragged = false;
    svg.addEventListener("pointerdown", (event) => {
      [from, dragged] = [at(event), false];
      show(plot, nearest(from));
    });
    svg.addEventListener("pointermove", (event) => {
      const to = at(event);
      if (from !== null) if (Math.hypot(to.x - from.x, to.y - from.y) > drag) dragged = true;
      if (from === null) show(plot, nearest(to));
      else if (dragged) {
        svg.setPointerCapture(event.pointerId);
        show(plot, -1);
        mark(plot, from, to);
      }
    });
    svg.addEventListener("pointerup", () => {
      if (from !== null) if (!dragged) clearMarks();
      from = null;
    });
    svg.addEventListener("pointercancel", () => { from = null; });
    // A finger that is lifted leaves the answer there.
    svg.addEventListener("pointerleave", (event) => {
      if (event.pointerType === "mouse") if (from === null) show(plot, -1);
    });
    svg.addEventListener("focus", () => {
      if (!svg.matches(":focus-visible")) return;
      show(plot, plot.places.has(current) ? current : plot.order[0]);
      speak(current);
    });
    svg.addEventListener("blur", () => show(plot, -1));
    svg.addEventListener("keydown", (event) => {
      if (event.altKey || event.ctrlKey || event.metaKey) return;
      const to = step(plot, event.key);
      if (to < 0) return;
      event.preventDefault();
      if (event.shiftKey) {
        if (plot.begin < 0) plot.begin = Math.max(plot.order.indexOf(current), 0);
        mark(plot, plot.places.get(plot.order[plot.begin]), plot.places.get(plot.order[to]));
      } else plot.begin = -1;
      show(plot, plot.order[to]);
      speak(current);
    });
  }

  addEventListener("keydown", (event) => {
    if (event.key !== "Escape") return;
    clearMarks();
    show(null, -1);
  });
  addEventListener("pointerdown", (event) => { if (!event.target.closest("svg[data-plane]")) show(null, -1); });
  addEventListener("scroll", place, { passive: true });
  addEventListener("resize", place);
  for (const hint of document.querySelectorAll(".hint")) hint.hidden = plots.length === 0;
})();
