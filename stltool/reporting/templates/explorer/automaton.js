/* The automaton: as boxes, as a plane of two counters, or as strips. */

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
    left = 46,
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
