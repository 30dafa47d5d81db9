/* Probabilities as text, in full, for a cell, for a column. */

const SUPERSCRIPTS = "⁰¹²³⁴⁵⁶⁷⁸⁹";
const plural = (n, word) => `${n} ${word}${n === 1 ? "" : "s"}`;
const spaced = (n) => Number(n).toLocaleString("en").replace(/,/g, "\u202f");

function scientific(x, digits) {
  // 2.75·10⁻⁴
  const [mantissa, exponent] = x.toExponential(digits).split("e");
  const raised = [...String(Math.abs(Number(exponent)))].map((digit) => SUPERSCRIPTS[digit]).join("");
  return `${mantissa === "1" ? "" : `${mantissa}·`}10${Number(exponent) < 0 ? "⁻" : ""}${raised}`;
}
const amount = (x, digits) => (x > 0 && x < 1e-3 ? scientific(x, digits) : String(Number(x.toPrecision(digits + 1))));

function full(p) {
  // tells every probability from 0 and 1
  if (Number.isNaN(p)) return "not defined";
  if (p <= 0 || p >= 1) return p <= 0 ? "0" : "1";
  if (p > 0.999) return `1 − ${scientific(1 - p, 2)}`;
  return p < 1e-4 ? scientific(p, 2) : p.toPrecision(6);
}
function brief(p) {
  // for a cell
  if (Number.isNaN(p)) return "–";
  if (p <= 0 || p >= 1) return p <= 0 ? "0" : "1";
  if (p > 0.9995) return `1−${scientific(1 - p, 0)}`;
  if (p < 0.001) return scientific(p, 0);
  return p
    .toFixed(p > 0.99 ? 4 : 3)
    .replace(/^0/, "")
    .replace(/^(\.\d\d\d)0$/, "$1");
}
function failing(p) {
  // 1 − p for a narrow column
  const x = 1 - p;
  if (Number.isNaN(x)) return "–";
  if (x <= 0 || x >= 1) return x <= 0 ? "0" : "1";
  if (x < 1e-3) return `10⁻${[...String(Math.round(-Math.log10(x)))].map((digit) => SUPERSCRIPTS[digit]).join("")}`;
  return x.toFixed(x < 0.1 ? 3 : 2).replace(/^0/, "");
}
const clamped = (p) => Math.min(1 - 1e-15, Math.max(1e-15, p));
const logit = (p) => Math.log10(clamped(p) / (1 - clamped(p)));
const chance = (odds) => 1 / (1 + 10 ** -odds);
