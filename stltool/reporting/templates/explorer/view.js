/* What is looked at: a run, a step, and what is remembered on arrival there. */

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
      const first = M.choice_start[M.state[n]],
        every = Array.from({ length: M.choices(M.state[n]) }, (_, i) => i);
      for (const i of M.whole ? every : taken(M, base[n]).map(([j]) => j)) {
        for (let k = M.row_start[first + i]; k < M.row_start[first + i + 1]; k++) {
          if (M.possible(k)) found.add(M.target[k] * M.Q + M.memory[n]);
        }
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
  if (v < 0 && n < 0) return null; // not in this page
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
