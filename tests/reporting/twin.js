/* Runs templates/engine.js in node, on what tests/reporting/test_twin.py hands over, and prints what it finds. */
const engine = require(process.argv[2]);
const { explorer, automaton, edits, file } = JSON.parse(require("fs").readFileSync(0, "utf8"));
const M = engine.build(explorer, automaton.states, automaton.initial);
const policy = Int32Array.from(M.policy),
  V = new Float64Array(M.N);
const found = { nodes: M.N, checksum: M.checksum, edited: [] };
engine.evaluate(M, policy, V);
found.probability = engine.total(M, V);
found.values = Array.from(V, (x) => (Number.isNaN(x) ? null : x));
found.optimum = engine.total(M, engine.optimise(M, explorer.claim.maximize ? 1 : -1));
found.visits = Array.from(engine.visits(M, policy));
found.worst = engine.likeliest(M, policy, engine.FALSE);
found.best = engine.likeliest(M, policy, engine.TRUE);
for (const [n, i] of edits) {
  policy[n] = i;
  engine.evaluate(M, policy, V, M.step[n]);
  const P = engine.total(M, V);
  found.edited.push(Number.isNaN(P) ? null : P);
}
engine.npz(M, policy, explorer.header || "{}").then((bytes) => {
  if (file) require("fs").writeFileSync(file, bytes);
  for (const [n] of edits) policy[n] = M.policy[n];
  engine.evaluate(M, policy, V);
  found.undone = engine.total(M, V);
  console.log(JSON.stringify(found));
});
