/* The run as a table, which is the timeline too. */

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
  const name = (t) => E.states[at(t)[0]].replace(/^\((.*)\)$/, "$1");
  body.push(row(place, (t) => el("span", { class: "place" }, name(t))));
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
  const curve = el("td", { colspan: steps.length });
  body.push(el("tr", { "aria-hidden": "true" }, el("th", {}, "P, odds scale"), curve));
  const table = $("line");
  table.replaceChildren(el("caption", { class: "sr" }, "The run step by step"), el("tbody", {}, ...body));
  curve.append(spark(numbers, curve, values));
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
  const phrase = (span) => el("div", { class: "phrase", style: `--n:${span.n}`, title: span.text }, span.text);
  const cell = (span) => el("td", { colspan: span.n }, phrase(span));
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
function spark(columns, curve, values) {
  const odds = values.filter((p) => p > 0 && p < 1).map(logit);
  const low = Math.min(...odds, range[1] - 0.5),
    high = Math.max(range[1], ...odds);
  const y = (p) => 42 - 38 * (p >= 1 ? 1 : !(p > 0) ? 0 : (logit(p) - low) / (high - low || 1));
  // below the steps, whose columns may differ in width
  const x = (i) => (100 * (columns[i].offsetLeft - curve.offsetLeft + columns[i].offsetWidth / 2)) / curve.offsetWidth;
  const d = values.map((p, i) => `${i ? "L" : "M"}${x(i)} ${y(p)}`).join("");
  const now = x(Math.max(0, Math.min(view.t, end()) - run.start));
  return svg(
    "svg",
    { class: "spark", viewBox: "0 0 100 46", preserveAspectRatio: "none" },
    svg("path", { d }),
    svg("path", { class: "cursor", d: `M${now} 0V46` }),
  );
}
