/* The chosen place: its actions, and where they lead. */

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
    : !M.whole
      ? ""
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
    const below = Number.isNaN(v) || !M.whole
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
// The interval that nature picked in.
const rangeText = (range) =>
  range && range[0] < range[1] ? ` of ${percent(range[0])} … ${percent(range[1])}` : "";

function whatFollows(s, o, trial, onRun) {
  const n = o.n,
    options = trial !== null ? [[trial, 1]] : taken(M, policy[n]),
    kids = [];
  if (trial !== null && !M.whole && Number.isNaN(choiceValue(M, V, n, trial)))
    return el(
      "div",
      { class: "outcomes no-print" },
      el("p", { class: "last" }, `What ${actionOf(s, trial)} leads to is not in this page.`),
    );
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
          `${E.states[x.s]}${marks} · ${percent(x.p)}${rangeText(x.range)} `,
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
