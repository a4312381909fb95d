// What a design is held against: its constraints with their prices, and what provably no other could reach.

// What provably no other design reaches: a bar from the bound to what this design has.
function accountTable(point) {
  const bounds = point.bounds ?? [];
  if (!bounds.length) return null;
  const rows = bounds.flatMap(({ name, value, reached, gap, of, assumptions, remark }) => {
    const { label, unit, factor } = quantity(name);
    // From zero to the bound; the rest of the gauge is what could be gained.
    const bar = typeof gap === "number" ? signedBar(Math.min(Math.max(1 - gap, 0), 1), { low: 0, high: 1 }) : "";
    const known = typeof value === "number";
    const said = element(
      "details",
      {},
      element("summary", {}, known ? "Bound of what, and when" : "Why there is none"),
      ...[of ? `${of}.` : "", ...(assumptions ?? []).map((each) => `Holds if ${each}.`), remark ? `${remark}.` : ""]
        .filter(Boolean)
        .map((text) => element("p", {}, readable(text))),
    );
    return [
      element(
        "tr",
        {},
        rowHead(capital(label)),
        cell(withUnit(number(reached * factor), unit), "n"),
        cell(known ? withUnit(number(value * factor), unit) : missing, "n"),
        cell(bar, "bars"),
        cell(typeof gap === "number" ? `${number(100 * gap, 3)} %` : missing, "n"),
      ),
      element("tr", { class: "said" }, element("td", { colspan: "5" }, said)),
    ];
  });
  return table(
    "Two-sided account",
    [["Bound"], ["This design", "n"], ["None below", "n"], ["", "bars"], ["Could be better by at most", "n"]],
    rows,
    "account",
  );
}

// 1, 2 or 5 times a power of ten, a fiftieth of the bound at most: so little that a price is a straight line.
function priceStep(bound) {
  const size = Math.abs(bound) / 50 || 1;
  const power = 10 ** Math.floor(Math.log10(size) + 1e-9);
  return power * [5, 2, 1].find((each) => each <= (size / power) * 1.001);
}

// The multiplier in the units shown: what the objective changes by per unit more of the bound.
function priceOf({ name, multiplier, active }, point) {
  const known = run.quantities ?? {};
  if (!active || !multiplier || !Object.hasOwn(known, point.objective ?? "")) return null;
  const [bounded, aimed] = [quantity(name), quantity(point.objective)];
  const unit = [aimed.unit || "1", bounded.unit].filter(Boolean).join("/");
  return { rate: (multiplier / bounded.factor) * aimed.factor, bounded, aimed, unit };
}

function priceText(constraint, point) {
  const price = priceOf(constraint, point);
  if (!price) return "";
  const { rate, bounded, aimed } = price;
  const step = priceStep((constraint.lower ?? constraint.upper) * bounded.factor);
  const change = withUnit(number(Math.abs(rate * step), 2), aimed.unit);
  const more = withUnit(trimmed(step), bounded.unit);
  return `${more} more ${rate > 0 ? "costs" : "saves"} ${change} of ${aimed.label}`;
}

function stateOf({ value, slack, active }) {
  if (typeof slack === "number" && slack < -1e-6 * Math.max(Math.abs(value ?? 0), Number.MIN_VALUE))
    return "violated";
  if (active) return "active";
  return typeof value === "number" ? "inactive" : missing;
}

function constraintsTable(point) {
  const constraints = point.constraints ?? [];
  if (!constraints.length) return null;
  const rows = constraints.map((constraint) => {
    const { name, value, lower, upper, slack, multiplier, statement } = constraint;
    const state = stateOf(constraint),
      price = priceOf(constraint, point);
    const glyph = { violated: "✕\u00a0", active: "●\u00a0" }[state] ?? "";
    const bounds = [
      typeof lower === "number" ? `≥ ${limit(name, lower)}` : "",
      typeof upper === "number" ? `≤ ${limit(name, upper)}` : "",
    ];
    const shownPrice = price ? withUnit(number(price.rate, 3), price.unit) : number(multiplier, 3);
    return element(
      "tr",
      { class: state },
      rowHead(capital(quantity(name).label)),
      cell(shown(name, value), "n"),
      cell(bounds.filter(Boolean).join(", "), "n"),
      cell(state === "active" ? "0" : shown(name, slack), "n"),
      cell(shownPrice, "n"),
      cell(element("span", { class: `mark ${state === "violated" ? "unsound" : ""}` }, `${glyph}${state}`)),
      cell(priceText(constraint, point) || readable(statement ?? ""), "sentence"),
    );
  });
  return table(
    "Constraints",
    [
      ["Constraint"],
      ["Value", "n"],
      ["Bound", "n"],
      ["Slack", "n"],
      ["Multiplier", "n"],
      ["State"],
      ["What it costs"],
    ],
    rows,
  );
}
