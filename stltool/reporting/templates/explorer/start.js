/* Drawing it all, playing, keys; and the beginning. */

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
if (bodies && bodies.length > 1) pickBody();
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
const probabilities = E.claim.optimum === null ? "P" : "both probabilities";
const natures =
  E.nature &&
  ` Where probabilities are intervals, nature picks them for the ${E.nature.minimal ? "least" : "greatest"} P, ` +
    "knowing the situation and the action. Shown are its picks, which answer to every edit; sampled runs follow them.";
const partly =
  " All situations would be too many for a page. P after an action that the policy does not take is therefore shown " +
  "only where it leads to situations that are here, and the best possible P is not.";
$("agrees").textContent = agrees
  ? `This page computed ${probabilities} again, from the model, in ${spaced(M.N)} undecided situations that runs can ` +
    `reach${M.whole ? "" : " under the policy"}; the results agree to 10⁻¹².${natures || ""}${M.whole ? "" : partly}`
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
  stateAt,
  full,
  brief,
}; // for tests
