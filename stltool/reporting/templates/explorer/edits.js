/* The verdict above the picture, the edits below it and their export, and the picture as a table. */

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
