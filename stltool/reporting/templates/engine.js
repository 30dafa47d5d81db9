"use strict";
/* The checker's twin: the same induction on the same numbers, without any page, so that it also runs in node.

   A node is an undecided (t, s, q) that some policy reaches (reporting/explorer.py): nodes are numbered by t, then by
   s·Q + q, so a loop from the last to the first is backward induction. A policy is a number for each node: i ≥ 0 takes
   the state's i-th choice, NO_ACTION none, −2 − k mixes choices by the k-th mixture. Where it takes none, values are
   NaN, and so is every value that depends on them.

   If there are too many nodes, a page has only those that its policy comes to (`whole` is false then): what comes after
   other choices is UNKNOWN there, and values that depend on it are NaN.

   If the probabilities are intervals, nature picks them in every node, for the least value of each choice, or for the
   greatest; it answers to the values of the last policy that was evaluated. */

const NO_ACTION = -1;
const FALSE = -1,
  TRUE = -2,
  NEVER = -3, // in place of a next node: a verdict, or an edge of probability 0
  UNKNOWN = -4; // or a node that the page does not have

const ARRAYS = {
  u1: Uint8Array,
  u2: Uint16Array,
  u4: Uint32Array,
  i1: Int8Array,
  i4: Int32Array,
  f8: Float64Array,
};

function decode([kind, text]) {
  const raw = atob(text),
    bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return new ARRAYS[kind](bytes.buffer);
}

/* The model, the automaton (`Q` states, initial state `q0`) and the nodes, from an explorer's data. */
function build(data, Q, q0) {
  const A = {};
  for (const name of Object.keys(data.arrays)) A[name] = decode(data.arrays[name]);
  const S = A.choice_start.length - 1,
    h = data.horizon;
  const listed = (of, values) => Float64Array.from(of, (i) => values[i]);
  const M = { ...A, S, Q, h, q0, probability: listed(A.value, A.values), values: null };
  M.lower = A.lower ? listed(A.lower, A.lowers) : null;
  M.upper = A.upper ? listed(A.upper, A.uppers) : null;
  M.whole = data.whole;
  M.minimal = data.nature ? data.nature.minimal : false; // whether nature picks for the least value
  M.possible = (k) => (M.upper || M.probability)[k] > 0;
  M.most = 0;
  for (let s = 0; s < S; s++) M.most = Math.max(M.most, A.choice_start[s + 1] - A.choice_start[s]);
  M.choices = (s) => A.choice_start[s + 1] - A.choice_start[s];
  M.enter = (s, q) => A.delta[A.letter[s] * Q + q];
  M.verdictRow = (t) => {
    let i = 0;
    while (i + 1 < A.verdict_starts.length && A.verdict_starts[i + 1] <= t) i++;
    return i * Q;
  };
  M.verdict = (t, q) => A.verdict_rows[M.verdictRow(t) + q]; // 1 true, 0 false, −1 undecided
  findNodes(M);
  findEdges(M);
  return M;
}

function findNodes(M) {
  const { S, Q, h } = M,
    mark = new Uint8Array(S * Q),
    codes = new Set();
  M.layers = [];
  M.offset = [0];
  M.first = []; // the pairs in which a run can begin, decided or not
  for (let s = 0; s < S; s++) {
    if (!(M.initial[s] > 0)) continue;
    const q = M.enter(s, M.q0);
    M.first.push([s, q]);
    if (M.verdict(0, q) < 0) codes.add(s * Q + q);
  }
  let layer = Int32Array.from(codes).sort();
  for (let t = 0; t < h; t++) {
    M.layers.push(layer);
    M.offset.push(M.offset[t] + layer.length);
    mark.fill(0);
    const row = M.verdictRow(t + 1);
    const follow = (q, first, end) => {
      for (let k = M.row_start[first]; k < M.row_start[end]; k++) {
        if (!M.possible(k)) continue;
        const s2 = M.target[k],
          q2 = M.delta[M.letter[s2] * Q + q];
        if (M.verdict_rows[row + q2] < 0) mark[s2 * Q + q2] = 1;
      }
    };
    layer.forEach((code, j) => {
      const s = Math.floor(code / Q),
        q = code - s * Q,
        first = M.choice_start[s];
      if (M.whole) follow(q, first, M.choice_start[s + 1]);
      else for (const [i] of taken(M, M.policy[M.offset[t] + j])) follow(q, first + i, first + i + 1);
    });
    let n = 0;
    for (let i = 0; i < mark.length; i++) n += mark[i];
    layer = new Int32Array(n);
    for (let i = 0, j = 0; j < n; i++) if (mark[i]) layer[j++] = i;
  }
  M.N = M.offset[h];
  let sum = 2166136261; // FNV-1a over the codes of all layers: the page and Python mean the same nodes
  for (const codes of M.layers) for (const code of codes) sum = Math.imul(sum ^ code, 16777619) >>> 0;
  M.checksum = sum;
  M.node = (t, s, q) => {
    if (t < 0 || t >= h) return -1;
    const codes = M.layers[t],
      code = s * Q + q;
    let low = 0,
      high = codes.length - 1;
    while (low <= high) {
      const middle = (low + high) >> 1;
      if (codes[middle] < code) low = middle + 1;
      else if (codes[middle] > code) high = middle - 1;
      else return M.offset[t] + middle;
    }
    return -1;
  };
}

/* For every node its step, state and memory, and where each transition of its state leads: a node or a verdict. */
function findEdges(M) {
  const { S, Q, h, N } = M;
  M.step = new Uint16Array(N);
  M.state = new Int32Array(N);
  M.memory = new Int32Array(N);
  M.edge = new Uint32Array(N + 1);
  for (let t = 0, n = 0; t < h; t++) {
    for (const code of M.layers[t]) {
      const s = Math.floor(code / Q);
      M.step[n] = t;
      M.state[n] = s;
      M.memory[n] = code - s * Q;
      M.edge[n + 1] = M.edge[n] + M.row_start[M.choice_start[s + 1]] - M.row_start[M.choice_start[s]];
      n++;
    }
  }
  M.next = new Int32Array(M.edge[N]);
  const where = new Int32Array(S * Q);
  for (let t = 0; t < h; t++) {
    where.fill(UNKNOWN);
    if (t + 1 < h) M.layers[t + 1].forEach((code, i) => (where[code] = M.offset[t + 1] + i));
    const row = M.verdictRow(t + 1);
    for (let n = M.offset[t]; n < M.offset[t + 1]; n++) {
      const s = M.state[n],
        q = M.memory[n],
        end = M.row_start[M.choice_start[s + 1]];
      for (let k = M.row_start[M.choice_start[s]], e = M.edge[n]; k < end; k++, e++) {
        const s2 = M.target[k],
          q2 = M.delta[M.letter[s2] * Q + q],
          verdict = M.verdict_rows[row + q2];
        if (!M.possible(k)) M.next[e] = NEVER;
        else M.next[e] = verdict === 1 ? TRUE : verdict === 0 ? FALSE : where[s2 * Q + q2];
      }
    }
  }
}

const worth = (V, n) => (n >= 0 ? V[n] : n === TRUE ? 1 : n === UNKNOWN ? NaN : 0);

/* The probabilities of the transitions of a choice c in node n, if V is P of what comes after: the model's, or nature's
   picks in the intervals (checking/robust.py): to each its lower end, and what then lacks of 1 to the transitions in
   the order of their worth, to each at most its width. */
function picks(M, V, n, c) {
  const first = M.row_start[c],
    end = M.row_start[c + 1];
  if (!M.lower) return M.probability.subarray(first, end);
  const p = M.lower.slice(first, end),
    edge = M.edge[n] + first - M.row_start[M.choice_start[M.state[n]]],
    worths = Array.from(p, (_, j) => (M.minimal ? 1 : -1) * worth(V, M.next[edge + j])),
    order = Array.from(p, (_, j) => j).sort((a, b) => worths[a] - worths[b]);
  let left = 1;
  for (const x of p) left -= x;
  for (const j of order) {
    const more = Math.min(M.upper[first + j] - M.lower[first + j], left);
    p[j] += more;
    left -= more;
  }
  return p;
}

/* P from node n if its i-th choice is taken there, and V is P of what comes after. */
function choiceValue(M, V, n, i) {
  const s = M.state[n],
    c = M.choice_start[s] + i,
    p = picks(M, V, n, c),
    edge = M.edge[n] + M.row_start[c] - M.row_start[M.choice_start[s]];
  let sum = 0;
  for (let j = 0; j < p.length; j++) sum += p[j] * worth(V, M.next[edge + j]);
  return sum;
}

/* The choices that a policy's number stands for, with their weights: [[i, weight], …]; none for NO_ACTION. */
function taken(M, number) {
  if (number >= 0) return [[number, 1]];
  if (number === NO_ACTION) return [];
  const row = M.mixtures.subarray((-2 - number) * M.most, (-1 - number) * M.most);
  return Array.from(row, (weight, i) => [i, weight]).filter(([, weight]) => weight > 0);
}

function nodeValue(M, V, n, number) {
  if (number >= 0) return choiceValue(M, V, n, number);
  if (number === NO_ACTION) return NaN;
  let sum = 0;
  for (const [i, weight] of taken(M, number)) sum += weight * choiceValue(M, V, n, i);
  return sum;
}

/* Backward induction of a policy over the nodes up to layer `last` (by default all); V is filled in. */
function evaluate(M, policy, V, last = M.h - 1) {
  M.values = V;
  if (last < 0) return V;
  for (let n = M.offset[last + 1] - 1; n >= 0; n--) V[n] = nodeValue(M, V, n, policy[n]);
  return V;
}

/* The best values over all policies: the greatest, or for sign = −1 the least. */
function optimise(M, sign = 1) {
  const V = new Float64Array(M.N);
  for (let n = M.N - 1; n >= 0; n--) {
    let best = -Infinity;
    for (let i = 0, m = M.choices(M.state[n]); i < m; i++) best = Math.max(best, sign * choiceValue(M, V, n, i));
    V[n] = sign * best;
  }
  return V;
}

/* P of the task, from the values of the nodes. */
function total(M, V) {
  let sum = 0;
  for (const [s, q] of M.first) {
    const verdict = M.verdict(0, q);
    sum += M.initial[s] * (verdict >= 0 ? verdict : V[M.node(0, s, q)]);
  }
  return sum;
}

/* Where choice i leads from node n: states, memories, probabilities, their intervals if they have any, and the next node
   or verdict. */
function outcomes(M, n, i) {
  const s = M.state[n],
    q = M.memory[n],
    c = M.choice_start[s] + i,
    first = M.row_start[c],
    edge = M.edge[n] + first - M.row_start[M.choice_start[s]],
    found = [];
  picks(M, M.values, n, c).forEach((p, j) => {
    if (!(p > 0)) return;
    const s2 = M.target[first + j],
      range = M.lower ? [M.lower[first + j], M.upper[first + j]] : null;
    found.push({ s: s2, q: M.enter(s2, q), p, range, next: M.next[edge + j] });
  });
  return found;
}

/* The probability of coming to each node. */
function visits(M, policy) {
  const mu = new Float64Array(M.N);
  for (const [s, q] of M.first) {
    const n = M.node(0, s, q);
    if (n >= 0) mu[n] += M.initial[s];
  }
  for (let n = 0; n < M.N; n++) {
    if (!(mu[n] > 0)) continue;
    for (const [i, weight] of taken(M, policy[n])) {
      for (const o of outcomes(M, n, i)) if (o.next >= 0) mu[o.next] += mu[n] * weight * o.p;
    }
  }
  return mu;
}

/* The most probable run with a verdict (TRUE or FALSE; null: with any), as {p, steps: [[s, q, choice], …]}; null if there
   is none. Of equally probable ones the shortest, then the first by its states, as checking/likely.py has it. */
function likeliest(M, policy, wanted) {
  const W = new Float64Array(M.N),
    length = new Int32Array(M.N),
    to = new Array(M.N);
  const end = (n) => (n >= 0 ? W[n] : (wanted === null && n !== NEVER) || n === wanted ? 1 : 0);
  const better = (w, l, s, best) =>
    w > best.w * (1 + 1e-12) || (w >= best.w * (1 - 1e-12) && (l < best.l || (l === best.l && s < best.s)));
  for (let n = M.N - 1; n >= 0; n--) {
    let best = { w: 0, l: Infinity, s: Infinity };
    for (const [i, weight] of taken(M, policy[n])) {
      for (const o of outcomes(M, n, i)) {
        const w = weight * o.p * end(o.next),
          l = 1 + (o.next >= 0 ? length[o.next] : 0);
        if (w > 0 && better(w, l, o.s, best)) best = { w, l, s: o.s, i, o };
      }
    }
    W[n] = best.w;
    length[n] = best.l;
    to[n] = best;
  }
  let top = { w: 0, l: Infinity, s: Infinity };
  for (const [s, q] of M.first) {
    const verdict = M.verdict(0, q),
      n = verdict >= 0 ? (verdict ? TRUE : FALSE) : M.node(0, s, q);
    const w = M.initial[s] * end(n),
      l = n >= 0 ? length[n] : 0;
    if (w > 0 && better(w, l, s, top)) top = { w, l, s, q, n };
  }
  if (!(top.w > 0)) return null;
  const steps = [[top.s, top.q, -1]];
  for (let n = top.n; n >= 0; n = to[n].o.next) {
    steps[steps.length - 1][2] = to[n].i;
    steps.push([to[n].o.s, to[n].o.q, -1]);
  }
  return { p: top.w, steps };
}

/* Random numbers in [0, 1) from a seed (mulberry32): the same run for the same seed. */
function generator(seed) {
  return () => {
    seed = (seed + 0x6d2b79f5) | 0;
    let x = Math.imul(seed ^ (seed >>> 15), 1 | seed);
    x = (x + Math.imul(x ^ (x >>> 7), 61 | x)) ^ x;
    return ((x ^ (x >>> 14)) >>> 0) / 4294967296;
  };
}

function pick(options, weight, random) {
  let u = random();
  for (const option of options) {
    u -= weight(option);
    if (u < 0) return option;
  }
  return options[options.length - 1];
}

/* Go on from the last of `steps`, at step t, until a verdict, or until the policy takes no action. */
function follow(M, policy, steps, t, random) {
  for (; ; t++) {
    const last = steps[steps.length - 1],
      n = M.node(t, last[0], last[1]);
    if (n < 0) return steps;
    const options = taken(M, policy[n]);
    if (options.length === 0) return steps;
    last[2] = pick(options, ([, weight]) => weight, random)[0];
    const o = pick(outcomes(M, n, last[2]), (x) => x.p, random);
    steps.push([o.s, o.q, -1]);
  }
}

/* ------------------------------------------------------------------------------------------------ the policy as a file

   stltool/policy.py: choices by step as lists of words of 64 automaton states, if every node has one; else a table. */

function policyArrays(M, policy) {
  if (policy.some((number) => number < NO_ACTION)) {
    const table = new Float64Array(M.h * M.S * M.Q * M.most);
    for (let at = 0; at < table.length; at += M.most) table[at] = 1; // where no run comes
    for (let n = 0; n < M.N; n++) {
      const at = ((M.step[n] * M.S + M.state[n]) * M.Q + M.memory[n]) * M.most;
      table[at] = 0;
      for (const [i, weight] of taken(M, policy[n])) table[at + i] = weight;
    }
    return [["table", "<f8", [M.h, M.S, M.Q, M.most], table]];
  }
  if (policy.some((number) => number === NO_ACTION)) {
    const table = new Int32Array(M.h * M.S * M.Q).fill(NO_ACTION);
    for (let n = 0; n < M.N; n++) table[(M.step[n] * M.S + M.state[n]) * M.Q + M.memory[n]] = policy[n];
    return [["table", "<i4", [M.h, M.S, M.Q], table]];
  }
  const words = Math.ceil(M.Q / 64),
    first = [],
    start = [0],
    keys = [],
    bits = [];
  for (let t = 0; t < M.h; t++) {
    first.push(t);
    for (let n = M.offset[t]; n < M.offset[t + 1]; n++) {
      const key = BigInt(M.state[n] * words + Math.floor(M.memory[n] / 64));
      if (keys.length === start[t] || keys[keys.length - 1] !== key) {
        keys.push(key);
        bits.push(0n);
      }
      bits[bits.length - 1] |= 1n << BigInt(M.memory[n] % 64);
    }
    start.push(keys.length);
  }
  const steps = BigInt64Array.from(first, BigInt),
    [kind, Type] = M.most <= 256 ? ["|u1", Uint8Array] : ["<u4", Uint32Array];
  return [
    ["first", "<i8", [steps.length], steps],
    ["last", "<i8", [steps.length], steps],
    ["start", "<i8", [start.length], BigInt64Array.from(start, BigInt)],
    ["keys", "<i8", [keys.length], BigInt64Array.from(keys)],
    ["bits", "<u8", [bits.length], BigUint64Array.from(bits)],
    ["choice", kind, [M.N], Type.from(policy)],
  ];
}

/* A .npz that `Policy.load` reads, as bytes. */
async function npz(M, policy, header) {
  const text = new TextEncoder().encode(header);
  const arrays = [["header", "|u1", [text.length], text], ...policyArrays(M, policy)];
  return zip(arrays.map(([name, type, shape, array]) => [`${name}.npy`, npy(type, shape, array)]));
}

function npy(type, shape, array) {
  const bytes = new Uint8Array(array.buffer, array.byteOffset, array.byteLength);
  const sizes = shape.join(", ") + (shape.length === 1 ? "," : "");
  let head = `{'descr': '${type}', 'fortran_order': False, 'shape': (${sizes}), }`;
  head = head.padEnd(64 * Math.ceil((head.length + 11) / 64) - 11) + "\n";
  const out = new Uint8Array(10 + head.length + bytes.length);
  out.set([0x93, 78, 85, 77, 80, 89, 1, 0, head.length & 255, head.length >> 8]);
  out.set(new TextEncoder().encode(head), 10);
  out.set(bytes, 10 + head.length);
  return out;
}

async function deflated(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new CompressionStream("deflate-raw"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

async function zip(files) {
  const table = Uint32Array.from({ length: 256 }, (_, n) => {
    for (let k = 0; k < 8; k++) n = n & 1 ? 0xedb88320 ^ (n >>> 1) : n >>> 1;
    return n;
  });
  const crc = (bytes) => {
    let c = -1;
    for (const byte of bytes) c = table[(c ^ byte) & 255] ^ (c >>> 8);
    return (c ^ -1) >>> 0;
  };
  const fields = (list) => {
    const view = new DataView(new ArrayBuffer(list.reduce((n, [size]) => n + size, 0)));
    let at = 0;
    for (const [size, x] of list) {
      if (size === 4) view.setUint32(at, x, true);
      else view.setUint16(at, x, true);
      at += size;
    }
    return new Uint8Array(view.buffer);
  };
  const packs = typeof CompressionStream === "function",
    parts = [],
    central = [];
  let at = 0;
  for (const [name, bytes] of files) {
    const packed = packs ? await deflated(bytes) : bytes,
      text = new TextEncoder().encode(name);
    const common = [
      [2, 20],
      [2, 0],
      [2, packs ? 8 : 0],
      [2, 0],
      [2, 33],
      [4, crc(bytes)],
      [4, packed.length],
      [4, bytes.length],
      [2, text.length],
      [2, 0],
    ];
    const local = fields([[4, 0x04034b50], ...common]);
    central.push(fields([[4, 0x02014b50], [2, 20], ...common, [2, 0], [2, 0], [2, 0], [4, 0], [4, at]]), text);
    parts.push(local, text, packed);
    at += local.length + text.length + packed.length;
  }
  const size = central.reduce((n, c) => n + c.length, 0),
    n = files.length;
  const end = fields([
    [4, 0x06054b50],
    [2, 0],
    [2, 0],
    [2, n],
    [2, n],
    [4, size],
    [4, at],
    [2, 0],
  ]);
  const all = [...parts, ...central, end],
    out = new Uint8Array(at + size + end.length);
  let position = 0;
  for (const part of all) {
    out.set(part, position);
    position += part.length;
  }
  return out;
}

if (typeof module !== "undefined") {
  module.exports = {
    NO_ACTION,
    FALSE,
    TRUE,
    UNKNOWN,
    build,
    choiceValue,
    decode,
    evaluate,
    follow,
    generator,
    likeliest,
    npz,
    optimise,
    outcomes,
    taken,
    total,
    visits,
  };
}
