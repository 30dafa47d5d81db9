/* Elements of HTML and SVG. Names are only ever set as text. */

const began = performance.now();
const $ = (id) => document.getElementById(id);
const NS = "http://www.w3.org/2000/svg";
const el = (tag, attributes = {}, ...kids) => fill(document.createElement(tag), attributes, kids);
const svg = (tag, attributes = {}, ...kids) => fill(document.createElementNS(NS, tag), attributes, kids);
const label = (text) => document.createTextNode(text);

function fill(node, attributes, kids) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === false || value === undefined) continue;
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else if (name === "style")
      node.style.cssText = value; // the security policy forbids style attributes
    else node.setAttribute(name, value);
  }
  node.append(...kids.filter((kid) => kid !== null && kid !== undefined));
  return node;
}
