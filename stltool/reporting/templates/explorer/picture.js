/* The floor or the graph, and its legend. */

let cells = [], // by slot
  drawn = [];
const layer = {};

function pickBody() {
  // whose floor is drawn, if there are several
  const box = el("select", {
    id: "body",
    onchange: (event) => {
      layOut(bodies[Number(event.target.value)]);
      $("floor").replaceChildren();
      buildPicture();
      draw();
    },
  });
  box.append(...bodies.map((one, i) => el("option", { value: i }, one.name)));
  $("run").parentElement.after(el("label", { class: "pick" }, "Floor of ", box));
}
function buildPicture() {
  [cells, drawn] = [[], []];
  const many = slots.length > 40,
    fine = floor && W > 600,
    labels = body ? body.labels : E.labels;
  const root = svg("svg", {
    viewBox: `-4 -4 ${W + 8} ${H + 8}`,
    role: "group",
    class: many ? "many" : "",
    "aria-label": floor ? "The floor: value and action of each cell" : "The states: value and action of each",
  });
  const hatch = svg("pattern", {
    id: "hatch",
    width: 12,
    height: 12,
    patternUnits: "userSpaceOnUse",
    patternTransform: "rotate(45)",
  });
  hatch.append(
    svg("rect", { width: 12, height: 12, class: "hatch-a" }),
    svg("rect", { width: 2, height: 12, class: "hatch-b" }),
  );
  root.append(svg("defs", {}, hatch));
  if (floor) root.append(svg("rect", { class: "wall", width: W, height: H, rx: 4 }));
  else root.append(...links());
  layer.taken = svg("g", { "aria-hidden": "true" });
  root.append(layer.taken);
  const inks = svg("g", { class: "inks", "aria-hidden": "true" });
  slots.forEach((slot, i) => {
    const [x, y] = points[slot],
      names = body ? Object.keys(labels).filter((name) => labels[name].includes(slot)) : marksOf[slot];
    const group = svg("g", { class: "cell", role: "button", tabindex: i ? -1 : 0 });
    const shape = (kind) => {
      const inset = kind === "edge" ? 3 : 0;
      if (!floor) return svg("circle", { class: kind, cx: x, cy: y, r: kind === "edge" ? 46 : 48 });
      return svg("rect", {
        class: kind,
        x: x - 50 + inset,
        y: y - 50 + inset,
        width: 100 - 2 * inset,
        height: 100 - 2 * inset,
        rx: 3,
      });
    };
    const caption = floor
      ? svg(
          "text",
          { class: "fg", x: x - 38, y: y - (fine ? 22 : 26), "font-size": fine ? 22 : 15, "font-weight": 650 },
          label(names.join(" ")),
        )
      : svg(
          "text",
          { class: "caption", x, y: y - 58, "font-size": 22, "font-weight": 650, "text-anchor": "middle" },
          label([E.states[slot], ...names].join(" · ")),
        );
    const ink = svg("g"),
      hand = svg("g"),
      badge = svg("circle", { class: "badge", cx: x + 37, cy: y - 37, r: 0 });
    const value = svg("text", {
      class: "fg value",
      x,
      y: y + (floor ? 41 : 32),
      "font-size": fine ? 21 : floor ? 14.5 : 18,
      "text-anchor": "middle",
    });
    const title = svg("title");
    group.append(title, shape("bg"), shape("edge"));
    ink.append(caption, hand, value, badge);
    inks.append(ink);
    group.addEventListener("click", () => choose(stateAt(slot)));
    group.addEventListener("keydown", (event) => cellKey(event, slot));
    group.addEventListener("focus", () => {
      for (const u of slots) cells[u].group.setAttribute("tabindex", u === slot ? 0 : -1);
    });
    cells[slot] = { group, ink, hand, value, badge, title, fine };
    root.append(group);
  });
  if (floor) {
    for (const inside of Object.values(labels))
      root.append(svg("path", { class: "region", d: outline(inside), "aria-hidden": "true" }));
  }
  layer.trail = svg("g", { "aria-hidden": "true", class: "inks" });
  root.append(layer.trail, inks);
  $("floor").append(root);
  if (body) {
    const others = bodies.filter((one) => one !== body).map((one) => one.name);
    if (others.length)
      $("floor").append(
        el(
          "p",
          { class: "note" },
          `The floor of ${body.name}: what if it were in another cell, and ${others.join(", ")} where the run has them ` +
            "(circles with their names, where they are on the same floor).",
        ),
      );
  } else if (slots.length < M.S) {
    $("floor").append(
      el(
        "p",
        { class: "note" },
        `Drawn are ${slots.length} of ${M.S} states: those of the report's run, and those in which runs can ` +
          "be at most steps. The table below the picture has all.",
      ),
    );
  }
}
function links() {
  const seen = new Set(),
    found = [];
  for (const s of slots) {
    for (let k = M.row_start[M.choice_start[s]]; k < M.row_start[M.choice_start[s + 1]]; k++) {
      const u = M.target[k];
      if (u === s || !xy(u) || !M.possible(k) || seen.has(s * M.S + u)) continue;
      seen.add(s * M.S + u);
      found.push(svg("path", { class: "link", d: bend(s, u) }));
    }
  }
  return found;
}
function bend(s, u) {
  const [x, y] = xy(s),
    [X, Y] = xy(u),
    dx = X - x,
    dy = Y - y;
  return `M${x} ${y}Q${(x + X) / 2 - dy * 0.14} ${(y + Y) / 2 + dx * 0.14} ${X} ${Y}`;
}
function outline(of) {
  const key = (x, y) => `${x},${y}`,
    column = (slot) => (points[slot][0] - 50) / 100,
    row = (slot) => (points[slot][1] - 50) / 100;
  const inside = new Set(of.map((slot) => key(column(slot), row(slot))));
  let d = "";
  for (const s of of) {
    const x = column(s),
      y = row(s),
      left = x * 100 + 6,
      right = left + 88,
      top = y * 100 + 6,
      bottom = top + 88;
    const across = left - (inside.has(key(x - 1, y)) ? 12 : 0),
      down = top - (inside.has(key(x, y - 1)) ? 12 : 0);
    if (!inside.has(key(x, y - 1))) d += `M${across} ${top}H${right}`;
    if (!inside.has(key(x, y + 1))) d += `M${across} ${bottom}H${right}`;
    if (!inside.has(key(x - 1, y))) d += `M${left} ${down}V${bottom}`;
    if (!inside.has(key(x + 1, y))) d += `M${right} ${down}V${bottom}`;
  }
  return d;
}
function choose(s) {
  if (!shown(view.t, s, view.m)) return;
  view.s = s;
  draw();
}
const DIRECTIONS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
function cellKey(event, slot) {
  const s = stateAt(slot),
    move = DIRECTIONS[event.key];
  if (event.key === "Enter" || event.key === " ") {
    event.preventDefault();
    event.stopPropagation();
    choose(s);
    if (view.s === s) say(cells[slot].group.getAttribute("aria-label"));
    return;
  }
  if (!move) return;
  event.preventDefault();
  event.stopPropagation();
  let nearest = -1,
    least = Infinity;
  for (const u of slots) {
    // the nearest one in that direction
    const dx = points[u][0] - points[slot][0],
      dy = points[u][1] - points[slot][1];
    const along = dx * move[0] + dy * move[1],
      off = Math.abs(dx * move[1]) + Math.abs(dy * move[0]);
    if (along > 1 && along + 3 * off < least) [nearest, least] = [u, along + 3 * off];
  }
  if (nearest >= 0) cells[nearest].group.focus();
}
function drawPicture() {
  for (const slot of slots) drawCell(slot);
  drawTrail();
  if (floor) return;
  const here = following() ? at(view.t) : null,
    s = view.s !== null ? view.s : here ? here[0] : null;
  const o = s === null ? null : shown(view.t, s, view.m),
    paths = [];
  if (o && o.n >= 0) {
    for (const [i, weight] of tried.n === o.n ? [[tried.i, 1]] : taken(M, policy[o.n])) {
      for (const x of outcomes(M, o.n, i)) {
        if (x.s !== s && xy(x.s) && xy(s))
          paths.push(svg("path", { class: "taken", d: bend(s, x.s), "stroke-width": 3 + 13 * x.p * weight }));
      }
    }
  }
  layer.taken.replaceChildren(...paths);
}
function drawCell(slot) {
  const s = stateAt(slot),
    o = shown(view.t, s, view.m),
    c = cells[slot],
    open = !!o && o.n >= 0,
    k = o ? shade(o.p) : 0;
  const changed = open && edits.has(o.n),
    rare = open && !(mu[o.n] > 0),
    selected = view.s === s;
  const words = !o
    ? view.fill
      ? "no run can be here at this step"
      : "no run can be here now with this memory"
    : o.v === 1
      ? "the task holds here"
      : o.v === 0
        ? "the task is violated here"
        : `P ${full(o.p)}, action ${policyText(s, policy[o.n])}`;
  const other = o && o.pale ? `; with another memory: ${memoryText(o.q)}` : "";
  const marks = marksOf[s].length ? `, label ${marksOf[s].join(", ")}` : "";
  const text = `${stateText(s)}${marks}: ${words}${other}`;
  const key = [text, open ? policy[o.n] : "", o && o.p, selected, changed, rare].join();
  if (drawn[slot] === key) return;
  drawn[slot] = key;
  const classes = ["cell", k < 0.5 ? "l" : "h"];
  const when = {
    d1: k > 0.6,
    d2: k > 0.75,
    none: !o,
    won: o && o.v === 1,
    lost: o && o.v === 0,
    sel: selected,
    edit: changed,
    rare,
    pale: o && o.pale,
  };
  for (const [name, on] of Object.entries(when)) if (on) classes.push(name);
  c.group.setAttribute("class", classes.join(" "));
  c.ink.setAttribute("class", [...classes, "ink"].join(" "));
  c.group.style.setProperty("--m", String(Math.round((k < 0.5 ? k : k - 0.5) * 200)));
  c.badge.setAttribute("r", changed ? 10 : 0);
  const [x, y] = points[slot],
    hands = [];
  if (open) {
    for (const [i, weight] of taken(M, policy[o.n])) hands.push(arrow(s, i, x, y - (floor ? 5 : 10), 17, weight));
    if (!hands.length)
      hands.push(svg("text", { class: "fg", x, y: y + 4, "font-size": 20, "text-anchor": "middle" }, label("none")));
  } else if (o) {
    hands.push(
      svg(
        "text",
        { class: "fg", x, y: y + 12, "font-size": 40, "font-weight": 700, "text-anchor": "middle" },
        label(o.v ? "✓" : "✕"),
      ),
    );
  }
  c.hand.replaceChildren(...hands);
  c.value.textContent = open ? brief(o.p) : "";
  if (c.fine) c.value.setAttribute("font-size", c.value.textContent.length > 6 ? 17.5 : 21);
  c.title.textContent = text;
  c.group.setAttribute("aria-label", text);
  c.group.setAttribute("aria-pressed", String(selected));
  c.group.setAttribute("aria-disabled", String(!o));
}
function drawTrail() {
  const parts = [],
    last = Math.min(view.t, end()),
    from = Math.max(run.start, last - 6),
    up = floor ? 5 : 0;
  const steps = [];
  for (let t = from; t <= last; t++) if (xy(at(t)[0])) steps.push(at(t)[0]);
  if (floor && steps.length > 1) {
    const d = `M${steps.map((s) => `${xy(s)[0]} ${xy(s)[1] - up}`).join("L")}`;
    parts.push(svg("path", { class: "trail-case", d }));
    parts.push(svg("path", { class: "trail", d, "stroke-opacity": following() ? 0.85 : 0.35 }));
  } else {
    for (let i = 1; i < steps.length; i++) {
      parts.push(
        svg("path", {
          class: "trail",
          d: bend(steps[i - 1], steps[i]),
          "stroke-opacity": 0.2 + (0.7 * i) / (steps.length - 1),
        }),
      );
    }
  }
  const now = at(last);
  for (const one of bodies || []) {
    if (one === body || one.x.join() !== body.x.join() || one.y.join() !== body.y.join()) continue;
    const [cx, cy] = points[cellOf(anchor(), one)];
    parts.push(
      svg("circle", { class: "robot-case", cx, cy: cy - up, r: 36 }),
      svg("circle", { class: "robot away", cx, cy: cy - up, r: 36 }),
      svg("text", { class: "fg", x: cx, y: cy + 20, "font-size": 17, "text-anchor": "middle" }, label(one.name)),
    );
  }
  if (now && xy(now[0])) {
    const [cx, cy] = xy(now[0]),
      away = following() ? "" : " away",
      r = floor ? 29 : 54;
    for (const kind of ["robot-case", "robot"]) parts.push(svg("circle", { class: kind + away, cx, cy: cy - up, r }));
  }
  layer.trail.replaceChildren(...parts);
}
function drawLegend() {
  const [low, high] = range,
    ticks = [];
  let last = -1;
  for (const p of [0.01, 0.1, 0.25, 0.5, 0.75, 0.9, 0.99, 0.999, 0.9999, 0.99999, 0.999999, 0.9999999]) {
    const x = (logit(p) - low) / (high - low);
    if (x - last > 0.14 && x > 0.24 && x < 0.74) {
      ticks.push(el("span", { style: `left:${100 * x}%` }, String(p)));
      last = x;
    }
  }
  const key = (kid, text) => el("span", {}, svg("svg", { viewBox: "0 0 100 70", "aria-hidden": "true" }, kid), text);
  const line = (width, opacity) =>
    svg("path", {
      class: "key-line",
      d: "M15 35H80M60 17L80 35L60 53",
      "stroke-width": width,
      "stroke-opacity": opacity,
    });
  const box = (kind) => svg("rect", { class: kind, x: 5, y: 5, width: 80, height: 60, "stroke-width": 3 });
  $("legend").append(
    el("div", { class: "ramp", "aria-hidden": "true" }),
    el(
      "div",
      { class: "ramp-ticks" },
      el("span", {}, `P ≤ ${brief(chance(low))}`),
      ...ticks,
      el("span", { class: "end", style: "left:100%" }, `≥ ${brief(chance(high))}`),
    ),
    el(
      "div",
      { class: "keys" },
      key(line(11, 1), "action, reached by the policy"),
      key(line(6, 0.6), "action, not reached"),
      key(svg("circle", { class: "key-run", cx: 45, cy: 35, r: 22 }), "the run"),
      key(svg("circle", { class: "key-edit", cx: 45, cy: 35, r: 18 }), "edited"),
      key(box("key-none"), "no run can be here"),
      key(box("key-pale"), "paler: not with this memory, shown with the nearest that can be"),
    ),
    el("div", {}, "Colour and number: the probability that the task holds from there on, on a scale of odds."),
  );
}
