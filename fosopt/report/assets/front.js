// The overview: the front of two objectives, or bars of a single one.

const STRATEGY_MARKS = [
  ["circle", BLUE],
  ["square", ORANGE],
  ["triangle-up", GREEN],
  ["star", PURPLE],
  ["hexagon", SKY],
];
const DOMINATED = "#7b838d";
// Above this many points the front is drawn by WebGL, as the page's security policy assumes.
const WEBGL_POINTS = 10000;

// A point without a strategy was not searched for: the start design, or the one an analysis looks at.
const strategies = [...new Set(points.flatMap((point) => point.strategy ?? []))];

function strategyName(name) {
  return String(name).replaceAll("_", " ");
}

// Front order: strategy by strategy along the first objective, points without a value last.
function ordered() {
  if (objectives.length < 2) return points;
  const rank = (point) => (point.strategy ? strategies.indexOf(point.strategy) : strategies.length);
  const place = (point) => [rank(point), objective(point, 0) ?? Infinity];
  return [...points].sort((a, b) => {
    const [p, q] = [place(a), place(b)];
    return p[0] - q[0] || (p[1] < q[1] ? -1 : p[1] > q[1] ? 1 : 0);
  });
}

function onFront(point) {
  return objective(point, 0) !== null && objective(point, 1) !== null;
}

function hasFront() {
  return objectives.length > 1 && points.length > 1 && points.some(onFront);
}

function pointText(point) {
  const values = objectives.map(
    (name, index) => `${plain(quantity(name).label)}: ${plain(shown(name, objective(point, index)))}`,
  );
  const title = titleOf(point);
  return [
    `<b>Point ${plain(point.key)}</b>${title ? ` ${plain(title)}` : ""}`,
    ...values,
    `${plain(strategyName(point.strategy ?? ""))} ${plain(verdict(point))}`,
  ].join("<br>");
}

function frontTrace(members, name, more) {
  const [first, second] = [0, 1].map((index) => quantity(objectives[index]).factor);
  return {
    type: points.length > WEBGL_POINTS ? "scattergl" : "scatter",
    mode: "markers",
    name: plain(name),
    x: members.map((point) => objective(point, 0) * first),
    y: members.map((point) => (objective(point, 1) === null ? 0 : objective(point, 1) * second)),
    customdata: members.map((point) => point.key),
    hoverinfo: "text",
    hovertext: members.map(pointText),
    ...more,
  };
}

function strategyTraces(strategy, index) {
  const [symbol, color] = STRATEGY_MARKS[index % STRATEGY_MARKS.length];
  const members = ordered().filter((point) => point.strategy === strategy && onFront(point));
  const name = strategyName(strategy);
  const groups = [
    [
      members.filter((point) => isSound(point) && !point.dominated),
      `${name}, verified`,
      { mode: "lines+markers", line: { color, width: 1, dash: "dot" }, marker: { symbol, color, size: 9 } },
    ],
    [
      members.filter((point) => isSound(point) && point.dominated),
      `${name}, dominated`,
      {
        marker: { symbol: `${symbol}-open`, color: index ? color : DOMINATED, size: 9, line: { width: 1.6 } },
      },
    ],
    [
      members.filter((point) => !isSound(point)),
      `${name}, not verified`,
      {
        marker: {
          symbol: "x",
          color: VERMILION,
          size: 9,
          line: { width: 1, color: index ? color : VERMILION },
        },
      },
    ],
  ];
  return groups.filter(([some]) => some.length).map(([some, label, more]) => frontTrace(some, label, more));
}

// The start design is hidden at first where it would flatten the front; a click in the legend shows it.
function startTraces() {
  const members = points.filter((point) => !point.strategy && onFront(point));
  if (!members.length) return [];
  const searched = points.filter((point) => point.strategy && onFront(point));
  const most = (some) => Math.max(...some.map((point) => objective(point, 1)));
  const far = searched.length > 0 && most(members) > 3 * most(searched);
  const value = shown(objectives[1], most(members));
  const name = far ? `${titleOf(members[0])} (${value}, click to show)` : titleOf(members[0]);
  const marker = { symbol: "diamond-open", color: DOMINATED, size: 10, line: { width: 1.8 } };
  return [frontTrace(members, name || "start design", { marker, visible: far ? "legendonly" : true })];
}

// A strategy that has no points of its own may still stand in the comparison at the front's points.
function baselineTraces() {
  const rows = run.comparison ?? [];
  if (run.comparison_objective !== objectives[1]) return [];
  const [first, second] = [0, 1].map((index) => quantity(objectives[index]).factor);
  return comparedStrategies()
    .filter((name) => !strategies.includes(name))
    .map((name, index) => {
      const known = rows.filter(
        (row) => typeof row[name] === "number" && typeof row.at?.[objectives[0]] === "number",
      );
      const [symbol, color] = STRATEGY_MARKS[(strategies.length + index) % STRATEGY_MARKS.length];
      return {
        x: known.map((row) => row.at[objectives[0]] * first),
        y: known.map((row) => row[name] * second),
        mode: "lines+markers",
        name: `${plain(strategyName(name))} (comparison)`,
        line: { color, width: 1, dash: "dash" },
        marker: { symbol: `${symbol}-open`, color, size: 8 },
        hovertemplate: "%{x:.4g}, %{y:.4g}",
      };
    });
}

// ---- what is proven ----

function boundsNamed(name) {
  return points.flatMap((point) => {
    const found = (point.bounds ?? []).find((bound) => bound.name === name && typeof bound.value === "number");
    return found && onFront(point) ? [{ point, value: found.value }] : [];
  });
}

// The least mass is a bound on all structures that meet what the study requires, so the least of the points' bounds
// holds for the whole picture.
function massFloor() {
  const index = objectives.indexOf("structural_mass");
  const found = boundsNamed("mass_lower_bound");
  if (index < 0 || !found.length) return null;
  const { factor } = quantity("structural_mass");
  const value = Math.min(...found.map((bound) => bound.value)) * factor;
  const most = Math.max(...points.filter(isSound).map((point) => objective(point, index) ?? value)) * factor;
  return { index, value, room: Math.max(0.08 * (most - value), 1e-3 * value) };
}

function floorMarks(logarithmic) {
  const floor = massFloor();
  if (!floor) return { shapes: [], annotations: [] };
  const [key, other] = floor.index ? ["y", "x"] : ["x", "y"];
  const text = `proven: none lighter than ${number(floor.value)} kg`;
  const line = levelLine(floor.value, other, text);
  const least = floor.value - floor.room;
  const region = {
    type: "rect",
    [`${key}0`]: least,
    [`${key}1`]: floor.value,
    [`${other}0`]: 0,
    [`${other}1`]: 1,
    [`${other}ref`]: `${other} domain`,
    fillcolor: "#7b838d",
    opacity: 0.22,
    line: { width: 0 },
    layer: "below",
  };
  const note = { ...placed(line, key, logarithmic[floor.index]), font: { size: 11, color: INK } };
  if (!floor.index) Object.assign(note, { xanchor: "right", y: 0.5, yanchor: "middle", textangle: -90 });
  return {
    shapes: [region, { ...line.shape, line: { color: INK, width: 1.5 } }],
    annotations: [note],
  };
}

// From each point to what no controller on its own structure could do better than: a statement about that structure.
function controllerTraces() {
  const index = objectives.indexOf("jitter_total");
  if (index < 0) return [];
  const factors = [0, 1].map((k) => quantity(objectives[k]).factor);
  const key = index ? "y" : "x";
  return [
    ["jitter_bound_any", "no linear controller on the same structure below", INK],
    ["jitter_bound_pid", "no PID in its box on the same structure below", SKY],
  ].flatMap(([name, label, color]) => {
    const found = boundsNamed(name);
    if (!found.length) return [];
    const place = (k) =>
      found.map(({ point, value }) => (k === index ? value : objective(point, k)) * factors[k]);
    const reach = found.map(({ point, value }) => (objective(point, index) - value) * factors[index]);
    return [
      {
        x: place(0),
        y: place(1),
        mode: "markers",
        name: label,
        marker: { symbol: index ? "line-ew-open" : "line-ns-open", size: 13, color, line: { width: 2.2, color } },
        [`error_${key}`]: {
          type: "data",
          symmetric: false,
          array: reach,
          arrayminus: reach.map(() => 0),
          color,
          thickness: 1,
          width: 0,
        },
        hovertemplate: "%{x:.4g}, %{y:.4g}",
      },
    ];
  });
}

// Requirements are in the picture, and of the region below the floor as much as shows what it is.
function frontRange(index, logarithmic) {
  const floor = massFloor(),
    most = requirementOf(index);
  const include = [most, floor?.index === index ? floor.value : undefined].filter((value) => value !== undefined);
  const clipped = floor?.index === index && !logarithmic ? { clipmin: floor.value - 0.9 * floor.room } : {};
  return { autorangeoptions: { include, ...clipped } };
}

function frontCaption() {
  const valueless = points.some((point) => objective(point, 0) !== null && objective(point, 1) === null);
  const bounded = controllerTraces().length > 0;
  return [
    "Filled marks are verified, open ones dominated, crosses not verified; a ring marks the selected point.",
    ...(valueless ? ["The strip on top holds points that have no value to plot."] : []),
    ...(massFloor()
      ? ["Gray region: proven empty, no structure within its bounds that meets what the study requires of it lies there."]
      : []),
    ...(bounded
      ? [
          "A dash below a point: no controller of that kind on the same structure has less; other structures may.",
        ]
      : []),
    "The dotted line joins points and promises nothing between them.",
  ].join(" ");
}

// A requirement far from all points would flatten them; it then stands in the tables alone.
function requirementOf(index) {
  const name = objectives[index],
    most = requirements[name];
  if (typeof most !== "number") return undefined;
  const values = points.filter(onFront).map((point) => objective(point, index));
  const [low, high] = [Math.min(...values), Math.max(...values)];
  return most <= high + 2 * (high - low) && most >= low - 2 * (high - low) ? most * quantity(name).factor : undefined;
}

function frontFigure() {
  const [first, second] = [0, 1].map((index) => quantity(objectives[index]).factor);
  const valueless = points.filter((point) => objective(point, 0) !== null && objective(point, 1) === null);
  const data = [
    ...controllerTraces(),
    ...strategies.flatMap(strategyTraces),
    ...startTraces(),
    ...baselineTraces(),
  ];
  const wide = (values) =>
    values.every((value) => value > 0) && Math.max(...values) > 30 * Math.min(...values);
  const searched = points.filter((point) => point.strategy && onFront(point));
  const seen = searched.length ? searched : points.filter(onFront);
  const logarithmic = [0, 1].map((index) => wide(seen.map((point) => objective(point, index))));
  const { shapes, annotations } = floorMarks(logarithmic);
  const kind = (index) => ({
    ...(logarithmic[index] ? { type: "log" } : {}),
    ...frontRange(index, logarithmic[index]),
  });
  [
    [0, "y", first, "x"],
    [1, "x", second, "y"],
  ].forEach(([index, across, factor, key]) => {
    const name = objectives[index],
      most = requirements[name];
    if (typeof most !== "number" || requirementOf(index) === undefined) return;
    const line = levelLine(most * factor, across, `requirement ${limit(name, most)}`);
    shapes.push(line.shape);
    annotations.push(placed(line, key, logarithmic[index]));
  });
  if (valueless.length) {
    data.push(
      frontTrace(valueless, `no ${quantity(objectives[1]).label}`, {
        yaxis: "y2",
        marker: { symbol: "triangle-down", color: "#a64500", size: 10 },
      }),
    );
  }
  data.push({
    x: [],
    y: [],
    mode: "markers",
    hoverinfo: "skip",
    showlegend: false,
    name: "selected",
    cliponaxis: false,
    marker: { symbol: "circle-open", size: 19, color: INK, line: { width: 2.4 } },
  });
  return {
    data,
    layout: layout({
      xaxis: axis(heading(objectives[0]), { ...kind(0), mirror: valueless.length ? "all" : true }),
      yaxis: axis(heading(objectives[1]), { ...kind(1), domain: [0, valueless.length ? 0.9 : 1] }),
      ...(valueless.length
        ? {
            yaxis2: axis("", {
              domain: [0.93, 1],
              range: [-1, 1],
              tickvals: [0],
              ticktext: ["no value"],
              ticks: "",
              showgrid: false,
              fixedrange: true,
            }),
          }
        : {}),
      shapes,
      annotations,
      showlegend: true,
      margin: { l: 64, r: 14, t: 12, b: 48 },
      legend: { orientation: "h", x: 0, y: -0.16, yanchor: "top", font: { size: 11.5 } },
    }),
  };
}

// The ring around the selected point is the last trace.
function ringOf(point) {
  if (objective(point, 0) === null) return { x: [[]], y: [[]], yaxis: "y" };
  const [first, second] = [0, 1].map((index) => quantity(objectives[index]).factor);
  const y = objective(point, 1);
  return {
    x: [[objective(point, 0) * first]],
    y: [[y === null ? 0 : y * second]],
    yaxis: y === null ? "y2" : "y",
  };
}

// One objective: a bar for each point.
function barsFigure(selectedKey) {
  const rows = [...points].reverse().filter((point) => objective(point, 0) !== null);
  if (rows.length < 2) return null;
  const { factor } = quantity(objectives[0]);
  const where = rows.map((_, index) => index);
  const most = requirements[objectives[0]];
  const line =
    typeof most === "number"
      ? levelLine(most * factor, "y", `requirement ${limit(objectives[0], most)}`)
      : null;
  const sound = rows.map(isSound);
  const furthest = Math.max(...rows.map((point) => objective(point, 0)), most ?? 0) * factor;
  return {
    data: [
      {
        type: "bar",
        orientation: "h",
        width: 0.62,
        y: where,
        x: rows.map((point) => objective(point, 0) * factor),
        customdata: rows.map((point) => point.key),
        hoverinfo: "text",
        hovertext: rows.map(pointText),
        textposition: "outside",
        text: rows.map((point) => plain(shown(objectives[0], objective(point, 0)))),
        cliponaxis: false,
        marker: {
          color: sound.map((good) => (good ? BLUE : VERMILION)),
          pattern: { shape: sound.map((good) => (good ? "" : "/")), fgcolor: PAPER },
          line: { color: INK, width: rows.map((point) => (point.key === selectedKey ? 2.4 : 0)) },
        },
      },
    ],
    layout: layout({
      xaxis: axis(heading(objectives[0]), furthest > 0 ? { range: [0, 1.2 * furthest] } : {}),
      yaxis: axis("", {
        tickvals: where,
        ticktext: rows.map((point) => plain(titleOf(point) || point.key)),
        ticks: "",
        showgrid: false,
        range: [-0.6, rows.length - 0.4],
      }),
      shapes: line ? [line.shape] : [],
      annotations: line ? [{ ...line.note, yanchor: "bottom", textangle: 0, xanchor: "right" }] : [],
      margin: { l: 80, r: 14, t: 24, b: 44 },
    }),
  };
}
