/* The policy and its edits, and the values of all nodes under it. */

const base = Int32Array.from(M.policy),
  policy = Int32Array.from(base),
  V = new Float64Array(M.N),
  edits = new Map();
evaluate(M, policy, V);
const best = M.whole ? optimise(M, E.claim.maximize ? 1 : -1) : new Float64Array(M.N).fill(NaN),
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
