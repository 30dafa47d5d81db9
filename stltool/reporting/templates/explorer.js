"use strict";
/* The explorer of a report's page: what is seen. What is computed is engine.js. Names are only ever set as text. */
(() => {
  const began = performance.now();
  const $ = (id) => document.getElementById(id);

  // --------------------------------------------------------------------------------------------------------- elements

  const NS = "http://www.w3.org/2000/svg";
  const el = (tag, attributes = {}, ...kids) => fill(document.createElement(tag), attributes, kids);
  const svg = (tag, attributes = {}, ...kids) => fill(document.createElementNS(NS, tag), attributes, kids);
  const label = (text) => document.createTextNode(text);

  function fill(node, attributes, kids) {
    for (const [name, value] of Object.entries(attributes)) {
      if (value === null || value === false || value === undefined) continue;
      if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
      else if (name === "style")
        node.style.cssText = value; // the security policy forbids style attributes
      else node.setAttribute(name, value);
    }
    node.append(...kids.filter((kid) => kid !== null && kid !== undefined));
    return node;
  }

  // ------------------------------------------------------------------------------------------------------------- data

  const given = JSON.parse($("data").textContent);
  let lattice = null; // the picture of an automaton of two counters, made once
  const tracks = (given.automaton ? given.automaton.tracks : []).map((track) => {
    const phrases = track.levels.map((level) => level.phrase),
      numbers = track.levels.map((level) => level.number ?? 0);
    const mark = (level) =>
      level.status === "failed"
        ? "✕"
        : level.status === "done"
          ? "✓"
          : level.status === "due"
            ? "due"
            : level.number === null
              ? ""
              : String(level.number);
    return {
      name: track.name,
      phrases,
      numbers,
      of: decode(track.of),
      ticks: track.levels.map(mark),
      status: track.levels.map((level) => level.status),
      most: Math.max(1, ...numbers),
      counts: track.levels.filter((level) => level.number !== null).length > 1,
      risk: track.levels.some((level) => level.risk),
    };
  });
  const memoryText = (q) => {
    const texts = [...new Set(tracks.map((track) => track.phrases[track.of[q]]))];
    return texts.filter((text) => text !== "nothing pending" || texts.length === 1).join("; ");
  };
  const E = given.explorer;
  if (!E || E.refused) {
    if (given.automaton) drawAutomaton(given.automaton.initial, [], null);
    document.documentElement.dataset.ready = (performance.now() - began).toFixed(0);
    return;
  }
  const M = build(E, given.automaton.states, given.automaton.initial);
  const floor = E.position.kind === "floor";

  // -------------------------------------------------------------------------------------------------- numbers as text

  const SUPERSCRIPTS = "⁰¹²³⁴⁵⁶⁷⁸⁹";
  const plural = (n, word) => `${n} ${word}${n === 1 ? "" : "s"}`;
  const spaced = (n) => Number(n).toLocaleString("en").replace(/,/g, "\u202f");

  function scientific(x, digits) {
    // 2.75·10⁻⁴
    const [mantissa, exponent] = x.toExponential(digits).split("e");
    const raised = [...String(Math.abs(Number(exponent)))].map((digit) => SUPERSCRIPTS[digit]).join("");
    return `${mantissa === "1" ? "" : `${mantissa}·`}10${Number(exponent) < 0 ? "⁻" : ""}${raised}`;
  }
  const amount = (x, digits) => (x > 0 && x < 1e-3 ? scientific(x, digits) : String(Number(x.toPrecision(digits + 1))));

  function full(p) {
    // tells every probability from 0 and 1
    if (Number.isNaN(p)) return "not defined";
    if (p <= 0 || p >= 1) return p <= 0 ? "0" : "1";
    if (p > 0.999) return `1 − ${scientific(1 - p, 2)}`;
    return p < 1e-4 ? scientific(p, 2) : p.toPrecision(6);
  }
  function brief(p) {
    // for a cell
    if (Number.isNaN(p)) return "–";
    if (p <= 0 || p >= 1) return p <= 0 ? "0" : "1";
    if (p > 0.9995) return `1−${scientific(1 - p, 0)}`;
    if (p < 0.001) return scientific(p, 0);
    return p
      .toFixed(p > 0.99 ? 4 : 3)
      .replace(/^0/, "")
      .replace(/^(\.\d\d\d)0$/, "$1");
  }
  function failing(p) {
    // 1 − p for a narrow column
    const x = 1 - p;
    if (Number.isNaN(x)) return "–";
    if (x <= 0 || x >= 1) return x <= 0 ? "0" : "1";
    if (x < 1e-3) return `10⁻${[...String(Math.round(-Math.log10(x)))].map((digit) => SUPERSCRIPTS[digit]).join("")}`;
    return x.toFixed(x < 0.1 ? 3 : 2).replace(/^0/, "");
  }
  const clamped = (p) => Math.min(1 - 1e-15, Math.max(1e-15, p));
  const logit = (p) => Math.log10(clamped(p) / (1 - clamped(p)));
  const chance = (odds) => 1 / (1 + 10 ** -odds);

  // ------------------------------------------------------------------------------------------------ policy and values

  const base = Int32Array.from(M.policy),
    policy = Int32Array.from(base),
    V = new Float64Array(M.N),
    edits = new Map();
  evaluate(M, policy, V);
  const best = optimise(M, E.claim.maximize ? 1 : -1),
    P0 = total(M, V),
    Pbest = total(M, best);
  let P = P0,
    mu = visits(M, policy);
  const same = (ours, theirs) => theirs === null || Math.abs(ours - theirs) <= 1e-12;
  const agrees =
    same(P0, E.claim.probability) &&
    same(Pbest, E.claim.optimum) &&
    M.N === E.claim.nodes &&
    M.checksum === E.claim.checksum;

  function judge(last) {
    evaluate(M, policy, V, last);
    P = total(M, V);
    mu = visits(M, policy);
  }
  function edit(n, number) {
    policy[n] = number;
    if (number === base[n]) edits.delete(n);
    else edits.set(n, number);
    judge(M.step[n]);
    say(`P of the edited policy is ${full(P)}`);
  }
  function undoEdits() {
    policy.set(base);
    edits.clear();
    judge();
  }

  // ------------------------------------------------------------------------------------------------ what is looked at

  function reported() {
    const steps = [];
    let q = M.q0;
    E.run.states.forEach((s, t) => {
      q = M.enter(s, q);
      steps.push([s, q, E.run.choices[t] ?? -1]);
    });
    return { name: "report", start: 0, steps };
  }
  let seed = 1,
    playing = null,
    tried = { n: -1, i: -1 };
  let run = E.run ? reported() : sampled();
  const view = { t: 0, m: M.q0, s: null, fill: true }; // step, memory on arrival, a chosen state (null: the run's)
  const end = () => run.start + run.steps.length - 1;
  const at = (t) => (t >= run.start && t <= end() ? run.steps[t - run.start] : null);
  const before = (t) => (t > run.start ? run.steps[t - run.start - 1][1] : run.start === 0 ? M.q0 : run.before);
  const following = () => !!at(view.t) && view.m === before(view.t);
  const verdictAt = (t, q) => M.verdict(Math.min(t, M.h), q);

  const living = new Map();
  function alive(t) {
    // memories that a run can bring to step t
    if (t === 0) return [M.q0];
    if (!living.has(t)) {
      const found = new Set();
      for (const code of M.layers[t - 1]) found.add(code % M.Q);
      living.set(
        t,
        [...found].sort((a, b) => a - b),
      );
    }
    return living.get(t);
  }
  const possible = new Map();
  function canBe(t, s, m) {
    // whether a run can arrive in s at step t with memory m
    if (t === 0) return m === M.q0 && M.initial[s] > 0;
    if (!possible.has(t)) {
      const found = new Set();
      for (let n = M.offset[t - 1]; n < M.offset[t]; n++) {
        const u = M.state[n];
        for (let k = M.row_start[M.choice_start[u]]; k < M.row_start[M.choice_start[u + 1]]; k++) {
          if (M.probability[k] > 0) found.add(M.target[k] * M.Q + M.memory[n]);
        }
      }
      possible.set(t, found);
    }
    return possible.get(t).has(s * M.Q + m);
  }
  function look(t, s, m) {
    // state s at step t after memory m: node n or verdict v, and p from there on
    if (!canBe(t, s, m)) return null;
    const q = M.enter(s, m),
      v = verdictAt(t, q),
      n = v < 0 ? M.node(t, s, q) : -1;
    return { n, q, v, p: v >= 0 ? v : V[n], m };
  }
  function distance(q, m) {
    let sum = 0;
    for (const track of tracks) sum += Math.abs(track.of[q] - track.of[m]);
    return sum;
  }
  function shown(t, s, m) {
    // as `look`; where that memory cannot be, the nearest one that can, marked pale
    const here = look(t, s, m);
    if (here || !view.fill) return here;
    let nearest = -1,
      least = Infinity;
    for (const q of alive(t)) {
      if (canBe(t, s, q) && distance(q, m) < least) [nearest, least] = [q, distance(q, m)];
    }
    return nearest < 0 ? null : { ...look(t, s, nearest), pale: true };
  }
  function nearestMemory(t, m, part = -1, level = 0) {
    let nearest = m,
      least = Infinity;
    for (const q of alive(t)) {
      let d = 0;
      tracks.forEach((track, i) => {
        d += i === part ? 1000 * Math.abs(track.of[q] - level) : Math.abs(track.of[q] - track.of[m]);
      });
      if (d < least) [nearest, least] = [q, d];
    }
    return nearest;
  }
  const range = (() => {
    // of log-odds: the middle 96 % of what the policy reaches; beyond it colours do not change
    const all = [];
    for (let n = 0; n < M.N; n++) if (V[n] > 0 && V[n] < 1 && mu[n] > 0) all.push(logit(V[n]));
    if (all.length < 2) return [-1, 1];
    all.sort((a, b) => a - b);
    const low = all[Math.floor(0.02 * all.length)],
      high = all[Math.ceil(0.98 * all.length) - 1];
    const pad = Math.max(0, 0.6 - (high - low)) / 2;
    return [low - pad, high + pad];
  })();
  const shade = (p) =>
    !(p > 0) ? 0 : p >= 1 ? 1 : Math.min(1, Math.max(0, (logit(p) - range[0]) / (range[1] - range[0])));

  function go(t, m = null) {
    view.t = Math.max(0, Math.min(M.h, t));
    view.s = null;
    view.m = m !== null ? m : at(view.t) ? before(view.t) : nearestMemory(view.t, view.m);
    draw();
  }
  function setRun(next) {
    stop();
    run = next;
    go(run.start);
  }
  function sampled(from = null, t = 0, name = null) {
    const random = generator(seed++);
    if (!from) {
      const [s, q] = pick(M.first, ([state]) => M.initial[state], random);
      from = [[s, q, -1]];
    }
    return { name: name || `sample ${seed - 1}`, start: t, steps: follow(M, policy, from, t, random) };
  }

  // ------------------------------------------------------------------------------------------------------------ names

  const COMPASS = {
    N: [0, -1],
    NE: [1, -1],
    E: [1, 0],
    SE: [1, 1],
    S: [0, 1],
    SW: [-1, 1],
    W: [-1, 0],
    NW: [-1, -1],
    up: [0, -1],
    down: [0, 1],
    left: [-1, 0],
    right: [1, 0],
  };
  const W = floor ? E.position.width * 100 : innerWidth < 560 ? 620 : 1000,
    H = floor ? E.position.height * 100 : 640;
  const xy = new Array(M.S);
  E.position.shown.forEach((s, i) => {
    const x = E.position.x[i],
      y = E.position.y[i];
    xy[s] = floor ? [x * 100 + 50, y * 100 + 50] : [70 + x * (W - 140), 80 + y * (H - 150)];
  });
  const actionOf = (s, i) => E.actions[M.choice_action[M.choice_start[s] + i]];
  const place = floor ? "cell" : "state";
  const stateText = (s) => `${place} ${E.states[s]}`;
  const marksOf = E.states.map((_, s) => Object.keys(E.labels).filter((name) => E.labels[name].includes(s)));

  function heading(s, i) {
    // where an action points: its compass name, else its most probable successor
    const name = actionOf(s, i);
    if (floor && Object.hasOwn(COMPASS, name)) return COMPASS[name];
    const c = M.choice_start[s] + i;
    let goal = -1,
      p = 0;
    for (let k = M.row_start[c]; k < M.row_start[c + 1]; k++) {
      if (M.probability[k] > p) [goal, p] = [M.target[k], M.probability[k]];
    }
    if (!xy[goal] || !xy[s]) return null;
    const dx = xy[goal][0] - xy[s][0],
      dy = xy[goal][1] - xy[s][1],
      r = Math.hypot(dx, dy);
    return r && name !== "stay" ? [dx / r, dy / r] : null;
  }
  function arrow(s, i, x, y, size, weight = 1) {
    const to = heading(s, i),
      thin = weight < 1 ? `stroke-opacity:${(0.3 + 0.7 * weight).toFixed(2)}` : null;
    if (!to) return svg("circle", { class: "dot fg", cx: x, cy: y, r: size * 0.32 * Math.sqrt(weight) });
    const r = Math.hypot(...to),
      u = to[0] / r,
      v = to[1] / r,
      tip = [x + u * size, y + v * size],
      head = size * 0.62;
    const wing = (w) => `${tip[0] - u * head + w * v * head * 0.8} ${tip[1] - v * head - w * u * head * 0.8}`;
    const back = weight < 1 ? 0 : size; // arrows of a mixture start in one point
    return svg("path", {
      class: "arrow fs",
      style: thin,
      d: `M${x - u * back} ${y - v * back}L${tip[0]} ${tip[1]}M${wing(1)}L${tip[0]} ${tip[1]}L${wing(-1)}`,
    });
  }
  function glyph(s, i) {
    const to = heading(s, i);
    if (!to) return "•";
    const eighth = Math.round(Math.atan2(to[1], to[0]) / (Math.PI / 4));
    return ["→", "↘", "↓", "↙", "←", "↖", "↑", "↗"][((eighth % 8) + 8) % 8];
  }
  function policyText(s, number) {
    const options = taken(M, number);
    if (!options.length) return "no action";
    if (options.length === 1) return actionOf(s, options[0][0]);
    return options.map(([i, weight]) => `${actionOf(s, i)} ${percent(weight)}`).join(", ");
  }
  const percent = (x) => `${Number((100 * x).toPrecision(3))} %`;

  // ------------------------------------------------------------------------------------------------------ the picture

  const cells = new Array(M.S),
    layer = {},
    drawn = new Array(M.S);

  function buildPicture() {
    const many = E.position.shown.length > 40,
      fine = floor && E.position.width > 6;
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
    E.position.shown.forEach((s, i) => {
      const [x, y] = xy[s],
        names = marksOf[s];
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
            label([E.states[s], ...names].join(" · ")),
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
      group.addEventListener("click", () => choose(s));
      group.addEventListener("keydown", (event) => cellKey(event, s));
      group.addEventListener("focus", () => {
        for (const u of E.position.shown) cells[u].group.setAttribute("tabindex", u === s ? 0 : -1);
      });
      cells[s] = { group, ink, hand, value, badge, title, fine };
      root.append(group);
    });
    if (floor) {
      for (const states of Object.values(E.labels))
        root.append(svg("path", { class: "region", d: outline(states), "aria-hidden": "true" }));
    }
    layer.trail = svg("g", { "aria-hidden": "true", class: "inks" });
    root.append(layer.trail, inks);
    $("floor").append(root);
    if (E.position.shown.length < M.S) {
      $("floor").append(
        el(
          "p",
          { class: "note" },
          `Drawn are ${E.position.shown.length} of ${M.S} states: those of the report's run, and those in which runs can ` +
            "be at most steps. The table below the picture has all.",
        ),
      );
    }
  }
  function links() {
    const seen = new Set(),
      found = [];
    for (const s of E.position.shown) {
      for (let k = M.row_start[M.choice_start[s]]; k < M.row_start[M.choice_start[s + 1]]; k++) {
        const u = M.target[k];
        if (u === s || !xy[u] || M.probability[k] === 0 || seen.has(s * M.S + u)) continue;
        seen.add(s * M.S + u);
        found.push(svg("path", { class: "link", d: bend(s, u) }));
      }
    }
    return found;
  }
  function bend(s, u) {
    const [x, y] = xy[s],
      [X, Y] = xy[u],
      dx = X - x,
      dy = Y - y;
    return `M${x} ${y}Q${(x + X) / 2 - dy * 0.14} ${(y + Y) / 2 + dx * 0.14} ${X} ${Y}`;
  }
  function outline(states) {
    const key = (x, y) => `${x},${y}`,
      column = (s) => (xy[s][0] - 50) / 100,
      row = (s) => (xy[s][1] - 50) / 100;
    const inside = new Set(states.map((s) => key(column(s), row(s))));
    let d = "";
    for (const s of states) {
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
  function cellKey(event, s) {
    const move = DIRECTIONS[event.key];
    if (event.key === "Enter" || event.key === " ") {
      event.preventDefault();
      event.stopPropagation();
      choose(s);
      if (view.s === s) say(cells[s].group.getAttribute("aria-label"));
      return;
    }
    if (!move) return;
    event.preventDefault();
    event.stopPropagation();
    let nearest = -1,
      least = Infinity;
    for (const u of E.position.shown) {
      // the nearest state in that direction
      const dx = xy[u][0] - xy[s][0],
        dy = xy[u][1] - xy[s][1];
      const along = dx * move[0] + dy * move[1],
        off = Math.abs(dx * move[1]) + Math.abs(dy * move[0]);
      if (along > 1 && along + 3 * off < least) [nearest, least] = [u, along + 3 * off];
    }
    if (nearest >= 0) cells[nearest].group.focus();
  }
  function drawPicture() {
    for (const s of E.position.shown) drawCell(s);
    drawTrail();
    if (floor) return;
    const here = following() ? at(view.t) : null,
      s = view.s !== null ? view.s : here ? here[0] : null;
    const o = s === null ? null : shown(view.t, s, view.m),
      paths = [];
    if (o && o.n >= 0) {
      for (const [i, weight] of tried.n === o.n ? [[tried.i, 1]] : taken(M, policy[o.n])) {
        for (const x of outcomes(M, o.n, i)) {
          if (x.s !== s && xy[x.s] && xy[s])
            paths.push(svg("path", { class: "taken", d: bend(s, x.s), "stroke-width": 3 + 13 * x.p * weight }));
        }
      }
    }
    layer.taken.replaceChildren(...paths);
  }
  function drawCell(s) {
    const o = shown(view.t, s, view.m),
      c = cells[s],
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
    if (drawn[s] === key) return;
    drawn[s] = key;
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
    const [x, y] = xy[s],
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
    for (let t = from; t <= last; t++) if (xy[at(t)[0]]) steps.push(at(t)[0]);
    if (floor && steps.length > 1) {
      const d = `M${steps.map((s) => `${xy[s][0]} ${xy[s][1] - up}`).join("L")}`;
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
    if (now && xy[now[0]]) {
      const [cx, cy] = xy[now[0]],
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

  // ---------------------------------------------------------------------------------------------------------- sliders

  const sliders = {};
  function buildSliders() {
    const make = (id, name, input) => {
      const box = el("input", {
        type: "range",
        id,
        min: 0,
        step: 1,
        oninput: (event) => input(Number(event.target.value)),
      });
      const out = el("output", { for: id });
      $("sliders").append(el("div", { class: "slider" }, el("label", { for: id }, name), box, out));
      return { box, out, levels: [] };
    };
    sliders.step = make("step", "Step", (t) => {
      stop();
      go(t, following() && at(t) ? before(t) : nearestMemory(t, view.m));
    });
    sliders.step.box.max = M.h;
    sliders.parts = [];
    if (tracks.every((track) => track.phrases.length < 2)) return;
    sliders.parts = tracks.map((track, i) =>
      make(`part${i}`, track.name, (k) => {
        stop();
        view.m = nearestMemory(view.t, view.m, i, sliders.parts[i].levels[k]);
        view.s = null;
        draw();
      }),
    );
    const box = el("input", {
      type: "checkbox",
      id: "fill",
      onchange: (event) => {
        view.fill = event.target.checked;
        view.s = null;
        draw();
      },
    });
    box.checked = true;
    $("sliders").append(el("label", { class: "tickbox" }, box, `fill the other ${place}s with the nearest memory`));
  }
  function drawSliders() {
    const set = (slider, value, text) => {
      slider.box.value = value;
      slider.out.textContent = text;
      slider.box.setAttribute("aria-valuetext", text);
    };
    set(sliders.step, view.t, `step ${view.t} of ${M.h}`);
    sliders.parts.forEach((slider, i) => {
      const track = tracks[i];
      slider.levels = [...new Set(alive(view.t).map((q) => track.of[q]))].sort((a, b) => a - b);
      slider.box.max = Math.max(0, slider.levels.length - 1);
      slider.box.disabled = slider.levels.length < 2;
      set(slider, Math.max(0, slider.levels.indexOf(track.of[view.m])), track.phrases[track.of[view.m]]);
    });
    const back = (t) => el("button", { type: "button", class: "small", onclick: () => go(t) }, "Back to the run");
    const note = $("follow-note");
    if (following() && view.s === null)
      note.replaceChildren(`The picture: what if the run, with its past, were in another ${place} now.`);
    else if (following()) note.replaceChildren(`Same past, another ${place}. `, back(view.t));
    else note.replaceChildren("Another memory than the run's. ", back(Math.min(Math.max(view.t, run.start), end())));
  }

  // ------------------------------------------------------------------------------------------------- the chosen place

  function drawHere() {
    const box = $("here"),
      here = following() ? at(view.t) : null,
      s = view.s !== null ? view.s : here ? here[0] : null;
    const o = s === null ? null : shown(view.t, s, view.m);
    if (!o) {
      box.replaceChildren(el("p", { class: "note" }, `Choose a ${place} in the picture to see its actions.`));
      return;
    }
    const names = marksOf[s],
      kids = [
        el(
          "h3",
          {},
          `Step ${view.t}, ${stateText(s)}`,
          names.length ? el("span", { class: "tag" }, names.join(", ")) : null,
        ),
        el("p", { class: "memory" }, `Remembered now: ${memoryText(o.q)}`),
      ];
    if (o.v >= 0) {
      const chip = el("span", { class: `chip ${o.v ? "good" : "bad"}` }, o.v ? "✓ satisfied" : "✕ violated");
      kids.push(el("p", { class: "p-here" }, chip));
    } else kids.push(...choices(s, o, !!here && here[0] === s));
    box.replaceChildren(...kids);
  }
  function choices(s, o, onRun) {
    const n = o.n,
      values = Array.from({ length: M.choices(s) }, (_, i) => choiceValue(M, V, n, i));
    const sign = E.claim.maximize ? 1 : -1,
      known = values.filter((v) => !Number.isNaN(v));
    const top = known.length ? sign * Math.max(...known.map((v) => sign * v)) : NaN;
    const weights = new Map(taken(M, policy[n])),
      wereWeights = new Map(taken(M, base[n]));
    const trial = tried.n === n && policy[n] !== tried.i,
      selected = (i) => (trial ? i === tried.i : weights.has(i));
    const loss = sign * (best[n] - V[n]),
      bestWord = E.claim.maximize ? "best" : "least";
    const rest = Number.isNaN(V[n])
      ? "the policy takes no action here, or later on"
      : loss > 1e-13
        ? `${bestWord} possible: ${full(best[n])}`
        : `the ${bestWord} possible`;
    const rows = values.map((v, i) => {
      const share = weights.get(i),
        tag =
          share === undefined
            ? wereWeights.has(i) && edits.has(n)
              ? "before"
              : null
            : edits.has(n)
              ? "edited"
              : share < 1
                ? `policy, ${percent(share)}`
                : "policy";
      const button = el(
        "button",
        {
          type: "button",
          "aria-pressed": String(selected(i)),
          onclick: () => {
            stop();
            tried = { n, i };
            drawHere();
            drawPicture();
            const again = document.querySelectorAll("#here .choices button")[i];
            if (again) again.focus();
          },
        },
        el("span", { class: "glyph", "aria-hidden": "true" }, glyph(s, i)),
        actionOf(s, i),
        tag ? el("span", { class: tag === "edited" ? "tag edit" : "tag" }, tag) : null,
      );
      const below = Number.isNaN(v)
        ? ""
        : v === top
          ? bestWord
          : `${sign > 0 ? "−" : "+"}${amount(Math.abs(top - v), 1)}`;
      return el(
        "tr",
        { class: selected(i) ? "on" : "" },
        el("th", { scope: "row" }, button),
        el("td", { class: "num" }, full(v)),
        el("td", { class: "num" }, below),
      );
    });
    const head = ["action", "P, then the policy", `off the ${bestWord}`].map((text, i) =>
      el("th", { scope: "col", class: i ? "num" : null }, text),
    );
    return [
      el("p", { class: "p-here" }, `P = ${full(V[n])} `, el("small", {}, rest)),
      el(
        "table",
        { class: "choices" },
        el("caption", { class: "sr" }, "Actions here"),
        el("thead", {}, el("tr", {}, ...head)),
        el("tbody", {}, ...rows),
      ),
      whatFollows(s, o, trial ? tried.i : null, onRun),
    ];
  }
  function whatFollows(s, o, trial, onRun) {
    const n = o.n,
      options = trial !== null ? [[trial, 1]] : taken(M, policy[n]),
      kids = [];
    if (options.length === 0) kids.push(el("p", {}, "The policy takes no action here. Choose one above."));
    for (const [i, weight] of options) {
      const name = actionOf(s, i);
      const text =
        trial !== null
          ? `If ${name} is taken instead, it leads to:`
          : weight < 1
            ? `The policy takes ${name} with ${percent(weight)}. What happens is up to you:`
            : `The policy takes ${name}. What happens is up to you:`;
      const buttons = outcomes(M, n, i)
        .sort((a, b) => b.p - a.p)
        .map((x) => {
          const from = x.next === TRUE ? "✓" : x.next === FALSE ? "✕" : `P ${brief(V[x.next])}`;
          const title =
            x.next === TRUE ? "satisfied" : x.next === FALSE ? "violated" : `P from there ${full(V[x.next])}`;
          const marks = marksOf[x.s].map((mark) => ` ${mark}`).join("");
          return el(
            "button",
            { type: "button", class: "small", title, onclick: () => branch(s, o, i, x) },
            `${E.states[x.s]}${marks} · ${percent(x.p)} `,
            el("span", { class: "dim" }, from),
          );
        });
      kids.push(el("p", {}, text), el("div", { class: "row" }, ...buttons));
    }
    const button = (text, act, kind = "small") => el("button", { type: "button", class: kind, onclick: act }, text);
    const refocus = () => {
      const on = document.querySelector("#here .choices tr.on button");
      if (on) on.focus();
    };
    if (trial !== null) {
      kids.push(
        el(
          "p",
          { class: "last" },
          button(
            `Use ${actionOf(s, trial)} here in the policy`,
            () => {
              edit(n, trial);
              tried = { n: -1, i: -1 };
              draw();
              refocus();
            },
            "small primary",
          ),
        ),
      );
    } else if (edits.has(n)) {
      kids.push(
        el(
          "p",
          { class: "last" },
          button("Undo this edit", () => {
            edit(n, base[n]);
            draw();
            refocus();
          }),
        ),
      );
    } else
      kids.push(el("p", { class: "last dim" }, "Choose an outcome to branch the run, or another action to try it."));
    if (!onRun && trial === null && options.length) {
      kids.push(
        el(
          "p",
          { class: "last" },
          button("Start a run here", () => {
            const next = sampled([[s, o.q, -1]], view.t, "from here");
            setRun({ ...next, before: o.m });
          }),
        ),
      );
    }
    return el("div", { class: "outcomes no-print" }, ...kids);
  }
  function branch(s, o, i, x) {
    stop();
    const here = following() ? at(view.t) : null,
      onRun = !!here && here[0] === s;
    const kept = onRun ? run.steps.slice(0, view.t - run.start).map((step) => [...step]) : [];
    const start = onRun ? run.start : view.t,
      prior = onRun ? run.before : o.m;
    const steps = follow(M, policy, [...kept, [s, o.q, i], [x.s, x.q, -1]], view.t + 1, generator(seed++));
    tried = { n: -1, i: -1 };
    run = { name: "your branch", start, before: prior, steps };
    go(view.t + 1);
    say(`Branched: step ${view.t}, ${stateText(x.s)}`);
  }

  // ----------------------------------------------------------------------------------------------- the run as a table

  function drawLine() {
    const steps = [],
      values = [];
    for (let t = run.start; t <= end(); t++) {
      const [s, q] = at(t),
        v = verdictAt(t, q);
      steps.push(t);
      values.push(v >= 0 ? v : V[M.node(t, s, q)]);
    }
    const kind = (t) => (t === view.t ? "now" : t > view.t ? "later" : null);
    const row = (name, cell) =>
      el(
        "tr",
        {},
        el("th", { scope: "row", title: name }, name),
        ...steps.map((t) => el("td", { class: kind(t) }, cell(t))),
      );
    const numbers = steps.map((t) => {
      const attributes = {
        type: "button",
        "aria-label": `Go to step ${t}`,
        "aria-current": t === view.t ? "step" : null,
        onclick: () => {
          stop();
          go(t);
        },
      };
      return el("td", { class: t === view.t ? "now" : null }, el("button", attributes, String(t)));
    });
    const body = [el("tr", {}, el("th", { scope: "row" }, "step"), ...numbers)];
    body.push(row(place, (t) => E.states[at(t)[0]].replace(/^\((.*)\)$/, "$1")));
    body.push(row("label", (t) => marksOf[at(t)[0]].join(" ")));
    for (const track of tracks)
      if (track.phrases.length > 1)
        body.push(
          track.counts
            ? row(track.name + (track.risk ? ", waiting" : ""), (t) => bar(track, t))
            : phraseRow(track, steps),
        );
    body.push(
      row("action", (t) => {
        const [s, , i] = at(t);
        if (i >= 0 && t < end())
          return el("span", { title: actionOf(s, i) }, glyph(s, i), el("span", { class: "sr" }, actionOf(s, i)));
        return verdictChip(t);
      }),
    );
    body.push(row("P of failing", (t) => failing(values[t - run.start])));
    body.push(spark(steps, values));
    const table = $("line");
    table.replaceChildren(el("caption", { class: "sr" }, "The run step by step"), el("tbody", {}, ...body));
    const now = table.querySelector("td.now"),
      box = table.parentElement;
    if (now && box.scrollWidth > box.clientWidth) box.scrollLeft = now.offsetLeft - box.clientWidth / 2;
  }
  function phraseRow(track, steps) {
    // a phrase spans the steps for which it stays
    const spans = [];
    for (const t of steps) {
      const text = track.phrases[track.of[at(t)[1]]],
        last = spans[spans.length - 1];
      if (last && last.text === text) last.n++;
      else spans.push({ text, n: 1 });
    }
    const cell = (span) => el("td", { colspan: span.n }, el("div", { class: "phrase", title: span.text }, span.text));
    return el("tr", {}, el("th", { scope: "row", title: track.name }, track.name), ...spans.map(cell));
  }
  function bar(track, t) {
    const q = at(t)[1],
      level = track.of[q],
      status = track.status[level],
      failed = status === "failed";
    const height = (100 * (failed ? track.most : track.numbers[level])) / track.most;
    const near = track.risk && verdictAt(t, q) < 0 && (failed || status === "due");
    const done = track.risk && status === "done";
    return el(
      "div",
      { class: near ? "count near" : "count", style: `--f:${height}`, title: track.phrases[level] },
      height ? el("i") : null,
      el("b", { class: done ? "tick" : null, "aria-hidden": "true" }, track.ticks[level]),
      el("span", { class: "sr" }, track.phrases[level]),
    );
  }
  function verdictChip(t) {
    const v = verdictAt(t, at(t)[1]);
    if (v < 0) return el("span", { class: "chip" }, "–", el("span", { class: "sr" }, "no action"));
    return el(
      "span",
      { class: `chip ${v ? "good" : "bad"}` },
      v ? "✓" : "✕",
      el("span", { class: "sr" }, v ? "satisfied" : "violated"),
    );
  }
  function spark(steps, values) {
    const odds = values.filter((p) => p > 0 && p < 1).map(logit);
    const low = Math.min(...odds, range[1] - 0.5),
      high = Math.max(range[1], ...odds),
      n = steps.length;
    const y = (p) => 42 - 38 * (p >= 1 ? 1 : !(p > 0) ? 0 : (logit(p) - low) / (high - low || 1));
    const x = (i) => ((i + 0.5) * 100) / n;
    const d = values.map((p, i) => `${i ? "L" : "M"}${x(i)} ${y(p)}`).join("");
    const now = x(Math.max(0, Math.min(view.t, end()) - run.start));
    const picture = svg(
      "svg",
      { class: "spark", viewBox: "0 0 100 46", preserveAspectRatio: "none" },
      svg("path", { d }),
      svg("path", { class: "cursor", d: `M${now} 0V46` }),
    );
    return el("tr", { "aria-hidden": "true" }, el("th", {}, "P, odds scale"), el("td", { colspan: n }, picture));
  }

  // ---------------------------------------------------------------------------------------------------- status, edits

  function drawStatus() {
    const here = at(view.t),
      last = at(end()),
      over = view.t >= end() ? verdictAt(end(), last[1]) : -1;
    $("where").textContent = `step ${view.t} of ${M.h}`;
    $("chip").className = `chip${over === 1 ? " good" : over === 0 ? " bad" : ""}`;
    $("chip").textContent =
      over >= 0
        ? `${over ? "✓ satisfied" : "✕ violated"} at step ${end()}`
        : here
          ? `undecided · P ${brief(V[M.node(view.t, here[0], here[1])])}`
          : "no run here";
    $("play").textContent = playing ? "❚❚ Pause" : "▶ Play";
    $("back").disabled = $("first").disabled = view.t <= run.start;
    $("on").disabled = $("last").disabled = view.t >= end();
    const pick = $("run");
    for (const option of [...pick.options]) if (option.value === "custom") option.remove();
    const known = [...pick.options].some((option) => option.value === run.name);
    if (!known)
      pick.append(
        el(
          "option",
          { value: "custom" },
          { "your branch": "Your branch", "from here": "From here on" }[run.name] ||
            `Sampled run ${run.name.replace("sample ", "")}`,
        ),
      );
    pick.value = known ? run.name : "custom";
  }
  function drawEdits() {
    const box = $("edited");
    box.hidden = edits.size === 0;
    if (!edits.size) return;
    const d = P - P0,
      change = Number.isNaN(P)
        ? ": it comes where the policy takes no action; choose one there"
        : d === 0
          ? ", unchanged"
          : `, ${d > 0 ? "+" : "−"}${amount(Math.abs(d), 3)} against ${full(P0)}`;
    const button = (text, id, act) => el("button", { type: "button", class: "small", id, onclick: act }, text);
    const listed = [...edits].map(([n, i]) => ({
      step: M.step[n],
      state: E.states[M.state[n]],
      remembered: memoryText(M.memory[n]),
      action: policyText(M.state[n], i),
      before: policyText(M.state[n], base[n]),
    }));
    box.replaceChildren(
      el("b", {}, plural(edits.size, "edit")),
      el("span", {}, "P of the edited policy = ", el("b", { class: "num", id: "edited-p" }, full(P)), change),
      el(
        "span",
        { class: "no-print" },
        E.header
          ? button("Export .npz", "export", async () =>
              save(new Blob([await npz(M, policy, E.header)]), "policy-edited.npz"),
            )
          : null,
        " ",
        button("List as JSON", "list", () =>
          save(new Blob([JSON.stringify({ P, edits: listed }, null, 1)]), "edits.json"),
        ),
        " ",
        button("Undo all", "undo", () => {
          undoEdits();
          draw();
        }),
      ),
      el(
        "span",
        { class: "note no-print" },
        E.header ? "Check it: stltool check TASK --policy policy-edited.npz" : `It cannot be exported: ${E.no_export}.`,
      ),
    );
  }
  function save(blob, name) {
    const link = el("a", { href: URL.createObjectURL(blob), download: name });
    document.body.append(link);
    link.click();
    link.remove();
    setTimeout(() => URL.revokeObjectURL(link.href), 4000);
  }
  const MOST_ROWS = 500;
  function drawTable() {
    if (!$("as-table").open) return;
    const rows = [];
    for (let s = 0; s < M.S && rows.length < MOST_ROWS; s++) {
      const o = shown(view.t, s, view.m);
      if (!o) continue;
      const open = o.n >= 0,
        cell = (text, kind = null) => el("td", { class: kind }, text);
      rows.push(
        el(
          "tr",
          {},
          el("th", { scope: "row" }, E.states[s]),
          cell(marksOf[s].join(", ")),
          cell(memoryText(o.q)),
          cell(open ? policyText(s, policy[o.n]) : o.v ? "satisfied" : "violated"),
          cell(full(o.p), "num"),
          cell(open ? full(best[o.n]) : "", "num"),
          cell(open ? full(mu[o.n]) : "", "num"),
        ),
      );
    }
    const head = [
      place,
      "labels",
      "remembered now",
      "action",
      "P",
      E.claim.maximize ? "best P" : "least P",
      "P of coming here",
    ];
    const more = rows.length === MOST_ROWS ? `; the first ${MOST_ROWS}` : "";
    $("map-table").replaceChildren(
      el("caption", { class: "note" }, `Step ${view.t}; remembered before it: ${memoryText(view.m)}${more}`),
      el("thead", {}, el("tr", {}, ...head.map((text) => el("th", { scope: "col" }, text)))),
      el("tbody", {}, ...rows),
    );
  }

  // ---------------------------------------------------------------------------------------------------- the automaton

  function drawAutomaton(q, trace, live) {
    const A = given.automaton,
      box = $("automaton"),
      note = $("automaton-note");
    const states = `${A.states} state${A.states === 1 ? "" : "s"}`;
    if (A.boxes.length) {
      box.replaceChildren(boxes(A, q, trace));
      note.textContent = `The automaton: ${states}; filled, what ${live ? "the run remembers now" : "it remembers at first"}.`;
    } else if (tracks.length === 2 && Math.max(...tracks.map((track) => track.phrases.length)) <= 40) {
      box.replaceChildren(plane(q, trace, live));
      note.textContent = `The automaton: ${states}, one for each pair of counters.${live ? ` Tinted: possible on arriving at step ${view.t}; line: the run; click one to see the policy with that memory.` : ""}`;
    } else {
      box.replaceChildren(
        ...tracks.map((track) => {
          const level = track.of[q],
            shownLevels = track.phrases.length <= 60 ? track.phrases : [];
          const dots = shownLevels.map((phrase, i) => el("i", { class: i === level ? "on" : null, title: phrase }));
          return el(
            "div",
            { class: "strip" },
            el("b", {}, track.name),
            el("span", { class: "boxes", "aria-hidden": "true" }, ...dots),
            el("span", { class: "note" }, track.phrases[level]),
          );
        }),
      );
      note.textContent = `The automaton: ${states}, made of ${tracks.length} part${tracks.length === 1 ? "" : "s"}; filled, what ${live ? "the run remembers now" : "it remembers at first"}.`;
    }
  }
  function boxes(A, q, trace) {
    const wide = 196,
      left = 64,
      gap = 30,
      at = new Map(),
      order = new Map();
    let y = 6;
    A.boxes.forEach((state, i) => {
      const tall = memoryText(state).length > 27 ? 44 : 30;
      at.set(state, { top: y, tall, middle: y + tall / 2 });
      order.set(state, i);
      y += tall + gap;
    });
    const used = (e) => trace.some((state, i) => i && trace[i - 1] === e.start && state === e.end);
    const text = (x, top, words, anchor = "start") =>
      svg(
        "text",
        { x, y: top, "text-anchor": anchor, class: "condition" },
        label(words === "true" ? "" : words.length > 34 ? `${words.slice(0, 33)}…` : words),
        svg("title", {}, label(words)),
      );
    const line = (e, d) => svg("path", { class: used(e) ? "edge-used" : "edge-plain", d, "marker-end": "url(#tip)" });
    const lines = [],
      words = [],
      groups = new Map();
    for (const e of A.arrows) {
      const from = at.get(e.start),
        to = at.get(e.end);
      if (e.start === e.end) {
        const m = from.middle;
        lines.push(line(e, `M${left} ${m - 7}C${left - 26} ${m - 18} ${left - 26} ${m + 18} ${left - 3} ${m + 7}`));
        if (e.text.length <= 6) words.push(text(left - 22, m + 4, e.text, "end"));
      } else if (order.get(e.end) === order.get(e.start) + 1) {
        lines.push(line(e, `M${left + wide / 2} ${from.top + from.tall}V${to.top - 3}`));
        words.push(text(left + wide / 2 + 9, from.top + from.tall + gap / 2 + 4, e.text));
      } else {
        // arcs with one goal and one condition share their lines' ends
        const key = `${e.end}|${e.text}`;
        groups.set(key, [...(groups.get(key) || []), e]);
      }
    }
    const reach = (list) => Math.min(...list.map((e) => Math.abs(order.get(e.start) - order.get(e.end))));
    let lane = 0;
    for (const list of [...groups.values()].sort((a, b) => reach(a) - reach(b))) {
      const right = left + wide + 22 + 22 * lane++,
        to = at.get(list[0].end),
        goal = to.middle + 5;
      let far = to.top;
      for (const e of list) {
        const m = at.get(e.start).middle - 5,
          turn = goal > m ? 7 : -7;
        lines.push(
          line(
            e,
            `M${left + wide} ${m}H${right - 7}Q${right} ${m} ${right} ${m + turn}V${goal - turn}Q${right} ${goal} ${right - 7} ${goal}H${left + wide + 3}`,
          ),
        );
        if (Math.abs(at.get(e.start).top - to.top) > Math.abs(far - to.top)) far = at.get(e.start).top;
      }
      words.push(text(right + 6, (far + to.top) / 2 + 18, list[0].text));
    }
    const nodes = A.boxes.map((state) => {
      const { top, tall } = at.get(state),
        now = state === q,
        bits = memoryText(state).split(" "),
        half = Math.ceil(bits.length / 2);
      const rows = tall > 30 ? [bits.slice(0, half).join(" "), bits.slice(half).join(" ")] : [memoryText(state)];
      const texts = rows.map((words2, i) =>
        svg(
          "text",
          { x: left + wide / 2, y: top + (rows.length > 1 ? 18 + 15 * i : 19.5), "text-anchor": "middle" },
          label(words2.length > 34 ? `${words2.slice(0, 33)}…` : words2),
        ),
      );
      return svg(
        "g",
        { class: now ? "box now" : "box" },
        svg("title", {}, label(memoryText(state))),
        svg("rect", { x: left, y: top, width: wide, height: tall, rx: 8 }),
        ...texts,
      );
    });
    const tip = svg(
      "marker",
      {
        id: "tip",
        viewBox: "0 0 8 8",
        refX: 6,
        refY: 4,
        markerWidth: 8,
        markerHeight: 8,
        markerUnits: "userSpaceOnUse",
        orient: "auto-start-reverse",
      },
      svg("path", { d: "M0 0L8 4L0 8z", class: "tip" }),
    );
    return svg(
      "svg",
      {
        viewBox: `0 0 ${Math.max(380, left + wide + 60 + 22 * lane)} ${y - gap + 6}`,
        role: "img",
        "aria-label": `The automaton with ${A.states} states; now: ${memoryText(q)}`,
      },
      svg("defs", {}, tip),
      ...lines,
      ...nodes,
      ...words,
    );
  }
  function plane(q, trace, live) {
    // two counters: a dot for each automaton state
    const [a, b] = tracks,
      across = a.phrases.length,
      up = b.phrases.length,
      unit = 22,
      left = 34,
      top = 8,
      size = 15;
    const spot = (state) => [left + (a.of[state] + 0.5) * unit, top + (up - b.of[state] - 0.5) * unit];
    if (!lattice) {
      lattice = { dots: [], trail: svg("path", { class: "walk" }), now: svg("circle", { r: 8.5, class: "spot" }) };
      const wide = left + across * unit + 6;
      const root = svg("svg", {
        viewBox: `0 0 ${wide} ${top + up * unit + 46}`,
        role: "img",
        style: `max-width:${1.5 * wide}px`,
      });
      const text = (x, y, words, kind, more = {}) =>
        svg("text", { x, y, class: kind, "text-anchor": "middle", ...more }, label(words));
      for (let state = 0; state < given.automaton.states; state++) {
        const [x, y] = spot(state);
        const dot = svg(
          "rect",
          { x: x - size / 2, y: y - size / 2, width: size, height: size, rx: 3.5 },
          svg("title", {}, label(memoryText(state))),
        );
        if (live) {
          dot.addEventListener("click", () => {
            if (!alive(view.t).includes(state)) return;
            stop();
            view.m = state;
            view.s = null;
            draw();
          });
        }
        lattice.dots.push(dot);
        root.append(dot);
      }
      root.append(lattice.trail, lattice.now);
      for (let i = 0; i < across; i++)
        root.append(text(left + (i + 0.5) * unit, top + up * unit + 12, a.ticks[i], "axis"));
      for (let i = 0; i < up; i++)
        root.append(text(left - 6, top + (up - i - 0.5) * unit + 3.5, b.ticks[i], "axis", { "text-anchor": "end" }));
      const title = (track) =>
        track.counts ? `${track.name}: steps ${track.risk ? "waiting" : "counted"}` : track.name;
      root.append(text(left + (across * unit) / 2, top + up * unit + 30, title(a), "axis-title"));
      root.append(
        text(0, 0, title(b), "axis-title", { transform: `translate(10 ${top + (up * unit) / 2}) rotate(-90)` }),
      );
      lattice.root = root;
    }
    const possibleNow = new Set(live || []);
    lattice.dots.forEach((dot, state) => dot.setAttribute("class", possibleNow.has(state) ? "dot-on" : "dot-off"));
    lattice.trail.setAttribute("d", trace.length ? `M${trace.map((state) => spot(state).join(" ")).join("L")}` : "");
    const [x, y] = spot(q);
    lattice.now.setAttribute("cx", x);
    lattice.now.setAttribute("cy", y);
    lattice.root.setAttribute("aria-label", `The automaton as a plane of two counters; now: ${memoryText(q)}`);
    return lattice.root;
  }
  function drawMemory() {
    const here = at(view.t),
      trace = [];
    for (let t = run.start; t <= Math.min(view.t, end()); t++) trace.push(at(t)[1]);
    drawAutomaton(following() && here ? here[1] : view.m, trace, alive(view.t));
  }

  // --------------------------------------------------------------------------------------------------------- together

  let timer = 0;
  function say(text) {
    clearTimeout(timer);
    timer = setTimeout(() => ($("say").textContent = text), 120);
  }
  function sayStep() {
    const here = at(view.t);
    if (!here) return;
    const v = verdictAt(view.t, here[1]),
      marks = marksOf[here[0]].map((mark) => `, ${mark}`).join("");
    const told = v >= 0 ? (v ? "satisfied" : "violated") : `P ${full(V[M.node(view.t, here[0], here[1])])}`;
    say(`Step ${view.t}, ${stateText(here[0])}${marks}; ${memoryText(here[1])}; ${told}`);
  }
  function draw() {
    drawPicture();
    drawSliders();
    drawHere();
    drawLine();
    drawStatus();
    drawEdits();
    drawTable();
    drawMemory();
  }
  function stop() {
    if (!playing) return;
    clearInterval(playing);
    playing = null;
    drawStatus();
  }
  function play() {
    if (playing) {
      stop();
      sayStep();
      return;
    }
    if (view.t >= end() || !following()) go(run.start);
    playing = setInterval(() => {
      if (view.t < end()) go(view.t + 1);
      if (view.t >= end()) {
        stop();
        sayStep();
      }
    }, 700);
    drawStatus();
  }
  function step(d) {
    stop();
    const from = following() ? view.t : Math.min(view.t, end());
    go(Math.max(run.start, Math.min(end(), from + d)));
    sayStep();
  }
  function jump(t) {
    stop();
    go(t);
    sayStep();
  }
  buildPicture();
  drawLegend();
  buildSliders();
  const kinds = [
    ["new", "Sample another run"],
    ["likely", "Most probable run"],
    ["bad", "Most probable violation"],
  ];
  if (E.run) kinds.unshift(["report", "The report's run"]);
  $("run").append(...kinds.map(([value, text]) => el("option", { value }, text)));
  function select(kind) {
    if (kind === "report") return setRun(reported());
    if (kind === "new") return setRun(sampled());
    const found = likeliest(M, policy, kind === "bad" ? FALSE : null);
    if (found) return setRun({ name: kind, start: 0, steps: found.steps });
    say("No run violates the task under this policy");
    drawStatus();
    $("where").textContent = "no run violates the task";
  }
  $("run").addEventListener("change", (event) => select(event.target.value));
  $("play").addEventListener("click", play);
  $("on").addEventListener("click", () => step(1));
  $("back").addEventListener("click", () => step(-1));
  $("first").addEventListener("click", () => jump(run.start));
  $("last").addEventListener("click", () => jump(end()));
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented) return;
    const tag = event.target.tagName;
    if (tag === "INPUT" || tag === "SELECT" || tag === "TEXTAREA") return;
    if (event.target !== document.body && !$("explorer").contains(event.target)) return;
    const scrolls = event.target.closest && event.target.closest(".scroll") && tag !== "BUTTON";
    if (scrolls && (event.key === "ArrowLeft" || event.key === "ArrowRight")) return;
    const does = {
      ArrowRight: () => step(1),
      ArrowLeft: () => step(-1),
      Home: () => jump(run.start),
      End: () => jump(end()),
      n: () => {
        setRun(sampled());
        sayStep();
      },
      b: () => jump(Math.min(Math.max(view.t, run.start), end())),
    }[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (event.key === " " && tag !== "BUTTON" && tag !== "SUMMARY") {
      event.preventDefault();
      play();
    } else if (does) {
      event.preventDefault();
      does();
    }
  });
  $("as-table").addEventListener("toggle", drawTable);
  $("agrees").textContent = agrees
    ? `This page computed ${E.claim.optimum === null ? "P" : "both probabilities"} again, from the model, in ${spaced(M.N)} undecided situations that runs can reach; the results agree to 10⁻¹².`
    : "This page's own computation disagrees with the checker's: do not trust the explorer.";
  if (!agrees) $("agrees").className = "warning";
  $("explorer").hidden = false;
  let tense = run.start,
    lowest = Infinity; // it opens where the reported run came closest to failing
  for (let t = run.start + 1; t < end(); t++) {
    const p = V[M.node(t, at(t)[0], at(t)[1])];
    if (p < lowest) [tense, lowest] = [t, p];
  }
  go(tense);
  document.documentElement.dataset.ready = (performance.now() - began).toFixed(0);
  globalThis.explorer = {
    E,
    M,
    V,
    base,
    policy,
    edits,
    best,
    edit,
    undoEdits,
    draw,
    go,
    view,
    select,
    likeliest,
    alive,
    tracks,
    memoryText,
    P: () => P,
    P0,
    Pbest,
    agrees,
    run: () => run,
    full,
    brief,
  }; // for tests
})();
