// Numbers, units and elements. Text reaches the page through text nodes only.

const run = JSON.parse(document.getElementById("run").textContent);
const points = run.points ?? [];
const objectives = run.objectives ?? [];
const requirements = run.requirements ?? {};
const missing = "–";

function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

function superscript(exponent) {
  return String(exponent)
    .replace("+", "")
    .replace("-", "⁻")
    .replace(/\d/g, (digit) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[digit]);
}

// Four digits tell two designs apart; more would claim an accuracy the model has not.
function number(value, digits = 4) {
  if (typeof value !== "number") return missing;
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e6 || size < 1e-3) {
    const [mantissa, exponent] = value.toExponential(digits - 1).split("e");
    return `${mantissa.replace("-", "−")}×10${superscript(exponent)}`;
  }
  const decimals = Math.max(0, digits - 1 - Math.floor(Math.log10(size)));
  const [whole, rest] = value.toFixed(decimals).split(".");
  const grouped = Math.abs(Number(whole)) >= 1e4 ? whole.replace(/\B(?=(\d{3})+$)/g, "\u202f") : whole;
  return (rest === undefined ? grouped : `${grouped}.${rest}`).replace("-", "−");
}

function unitText(unit) {
  if (!unit || unit === "-" || unit === "1") return "";
  return unit.replace(/\^(-?\d+)/g, (_, power) => superscript(power)).replace(/\bu(rad|m|s|N)\b/g, "µ$1");
}

// A metric with an index, such as natural_frequency[3], takes the unit of the metric.
function quantity(name) {
  const known = run.quantities ?? {};
  const base = name.replace(/\[.*$/, "");
  const found = Object.hasOwn(known, name) ? known[name] : Object.hasOwn(known, base) ? known[base] : {};
  const index = name.slice(base.length);
  const label = found.label
    ? Object.hasOwn(known, name)
      ? found.label
      : `${found.label} ${index}`.trim()
    : null;
  return {
    label: label ?? name.replaceAll("_", " "),
    unit: unitText(found.unit),
    factor: found.factor ?? 1,
  };
}

function capital(text) {
  return text.charAt(0).toUpperCase() + text.slice(1);
}

function withUnit(text, unit) {
  return unit && text !== missing ? `${text}\u00a0${unit}` : text;
}

function shown(name, value) {
  const { unit, factor } = quantity(name);
  return withUnit(number(typeof value === "number" ? value * factor : null), unit);
}

// A limit was typed by someone; it comes back without the zeros that a measured value carries.
function trimmed(value, digits = 4) {
  return number(value, digits)
    .replace(/(\.\d*?)0+(?=$|×)/, "$1")
    .replace(/\.(?=$|×)/, "");
}

function limit(name, value) {
  const { unit, factor } = quantity(name);
  return withUnit(trimmed(value * factor), unit);
}

function heading(name) {
  const { label, unit } = quantity(name);
  return unit ? `${capital(label)} (${unit})` : capital(label);
}

function scaled(values, factor) {
  return values.map((value) => (typeof value === "number" ? value * factor : null));
}

function objective(point, index) {
  const name = objectives[index];
  const value = point.metrics?.[name] ?? point.variables?.[name]?.[0];
  return typeof value === "number" ? value : null;
}

function isSound(point) {
  return Boolean(point.verified) && !["infeasible", "failed", "unstable"].includes(point.status);
}

function verdict(point) {
  if (isSound(point)) return point.dominated ? "verified, dominated" : "verified";
  return ["optimal", "evaluated"].includes(point.status) ? "not verified" : (point.status ?? "not verified");
}

// Labels and reasons name metrics as a study file does; a reader wants their labels.
function readable(text) {
  return String(text).replace(/\b\w+_\w+\b/g, (word) =>
    Object.hasOwn(run.quantities ?? {}, word) ? quantity(word).label : word,
  );
}

function titleOf(point) {
  return readable(point.case || point.label || "");
}
