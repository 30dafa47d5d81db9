/* What the page was given: the automaton's parts, and the model and the policy, if they can be explored. */

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
const bodies = E.position.bodies || null; // of a composition: the members whose floors can be drawn
