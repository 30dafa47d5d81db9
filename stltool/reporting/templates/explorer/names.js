/* Names of places and actions, and the arrows of actions. */

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
// The picture has slots: states, or the cells of one body, while the others stay where they are.
let body = null, // the member of a composition whose floor is drawn
  W = 0,
  H = 0,
  slots = [],
  points = []; // of each slot
function layOut(chosen) {
  body = chosen;
  const from = body || E.position;
  W = floor ? from.width * 100 : innerWidth < 560 ? 620 : 1000;
  H = floor ? from.height * 100 : 640;
  slots = body ? body.x.map((_, cell) => cell) : E.position.shown;
  points = [];
  slots.forEach((slot, i) => {
    const x = from.x[i],
      y = from.y[i];
    points[slot] = floor ? [x * 100 + 50, y * 100 + 50] : [70 + x * (W - 140), 80 + y * (H - 150)];
  });
}
layOut(bodies ? bodies[0] : null);
const cellOf = (s, of) => Math.floor(s / of.stride) % of.x.length;
const slotOf = (s) => (body ? cellOf(s, body) : s);
const xy = (s) => points[slotOf(s)];
function anchor() {
  // the state that the other bodies are in
  if (view.s !== null) return view.s;
  return at(Math.min(Math.max(view.t, run.start), end()))[0];
}
function stateAt(slot) {
  if (!body) return slot;
  const s = anchor();
  return s + (slot - slotOf(s)) * body.stride;
}
const actionOf = (s, i) => E.actions[M.choice_action[M.choice_start[s] + i]];
const place = floor && !bodies ? "cell" : "state";
const stateText = (s) => `${place} ${E.states[s]}`;
const marksOf = E.states.map((_, s) => Object.keys(E.labels).filter((name) => E.labels[name].includes(s)));

function heading(s, i) {
  // where an action points: its compass name, else its most probable successor
  const name = body ? body.actions[M.choice_action[M.choice_start[s] + i]] : actionOf(s, i);
  if (floor && Object.hasOwn(COMPASS, name)) return COMPASS[name];
  const c = M.choice_start[s] + i;
  let goal = -1,
    p = 0;
  for (let k = M.row_start[c]; k < M.row_start[c + 1]; k++) {
    if (M.probability[k] > p) [goal, p] = [M.target[k], M.probability[k]];
  }
  if (goal < 0 || !xy(goal) || !xy(s)) return null;
  const dx = xy(goal)[0] - xy(s)[0],
    dy = xy(goal)[1] - xy(s)[1],
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
