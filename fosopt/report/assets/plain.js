// Structures without bars: a beam with its stations, a chain of bodies on springs.

function frameless(more = {}) {
  return axis("", { showline: false, ticks: "", showticklabels: false, showgrid: false, mirror: false, ...more });
}

const PLACES = {
  hub: { symbol: "square", color: INK },
  mirror: { symbol: "diamond", color: VERMILION },
  actuator: { symbol: "hexagon", color: GREEN },
  support: { symbol: "triangle-up-open", color: MUTED },
};

// Marks of what is attached where; several things at one place share a label.
function placeTraces(places, position) {
  return Object.entries(PLACES).flatMap(([kind, { symbol, color }]) => {
    const some = places.filter((place) => place.kind === kind);
    if (!some.length) return [];
    const where = some.map(position);
    return [
      {
        x: where.map(([x]) => x),
        y: where.map(([, y]) => y),
        mode: kind === "support" ? "markers" : "markers+text",
        text: some.map(() => kind),
        textposition: kind === "actuator" ? "bottom center" : "top center",
        textfont: { size: 11.5, color: kind === "support" ? MUTED : color },
        cliponaxis: false,
        showlegend: false,
        hoverinfo: "text",
        hovertext: some.map((place) => plain(`${kind} at ${place.port}`)),
        marker: { symbol, color, size: kind === "support" ? 15 : 10, line: { width: 1.6, color } },
      },
    ];
  });
}

function beamFigure(beam, places) {
  // Hub and mirror have marks of their own.
  const stations = Object.entries(beam.stations).filter(([name]) => !places.some((place) => place.at === name));
  const data = [
    {
      x: [0, beam.length],
      y: [0, 0],
      mode: "lines",
      line: { color: "#8b929b", width: 9 },
      hoverinfo: "skip",
      showlegend: false,
    },
    {
      x: stations.map(([, x]) => x),
      y: stations.map(() => 0),
      mode: "markers+text",
      text: stations.map(([name]) => plain(name)),
      textposition: "bottom center",
      textfont: { size: 11, color: MUTED },
      cliponaxis: false,
      showlegend: false,
      hovertemplate: "%{text}<br>%{x:.4g} m<extra></extra>",
      marker: { symbol: "line-ns-open", size: 16, color: INK, line: { width: 1.4 } },
    },
    ...placeTraces(places, (place) => [place.xyz[0], 0]),
  ];
  const root = { type: "line", yref: "y", line: { color: INK, width: 4 } };
  return {
    data,
    layout: layout({
      xaxis: axis("x (m)", {
        range: [-0.05 * beam.length, 1.05 * beam.length],
        showgrid: false,
        mirror: false,
      }),
      yaxis: frameless({ range: [-1, 1], fixedrange: true }),
      shapes: beam.held ? [{ ...root, x0: 0, x1: 0, y0: -0.55, y1: 0.55 }] : [],
    }),
  };
}

function chainFigure(chain, places) {
  const { bodies, inertias, springs } = chain;
  const largest = Math.max(...inertias);
  const order = bodies.map((_, index) => index);
  const kinds = (body) =>
    places.filter((place) => place.at === body && place.kind !== "support").map((place) => place.kind);
  const labels = bodies.map(
    (body, index) =>
      `<b>${plain(body)}</b>${kinds(body).length ? ` (${kinds(body).join(", ")})` : ""}<br>${number(inertias[index])} kg m²`,
  );
  const note = (x, y, text, color) => ({ x, y, text, showarrow: false, font: { size: 11.5, color } });
  const wall = { type: "line", x0: -0.45, x1: -0.45, y0: -0.6, y1: 0.6, line: { color: INK, width: 4 } };
  return {
    data: [
      {
        x: order,
        y: order.map(() => 0),
        mode: "lines+markers",
        line: { color: "#8b929b", width: 3 },
        marker: {
          size: inertias.map((inertia) => Math.max(7, 64 * Math.sqrt(inertia / largest))),
          opacity: 1,
          color: bodies.map((body) => (kinds(body).includes("mirror") ? VERMILION : BLUE)),
          line: { color: INK, width: 1 },
        },
        cliponaxis: false,
        hoverinfo: "skip",
        showlegend: false,
      },
    ],
    layout: layout({
      xaxis: frameless({ range: [-0.6, bodies.length - 0.4], fixedrange: true }),
      yaxis: frameless({ range: [-1, 1], fixedrange: true }),
      shapes: chain.held ? [wall] : [],
      annotations: [
        ...labels.map((label, index) => note(index, -0.66, label, INK)),
        ...springs.map((spring, index) => note(index + 0.5, 0.3, `${number(spring)} N m/rad`, MUTED)),
      ],
      margin: { l: 20, r: 20, t: 12, b: 12 },
    }),
  };
}

function plainCaption(structure) {
  if (structure.kind === "beam") {
    const root = structure.held ? "fixed" : "pinned";
    return `Uniform beam of ${number(structure.length)} m, its root ${root}; marks show ports.`;
  }
  const held = structure.held ? "held at the first" : "free to turn";
  return (
    `Chain of ${structure.bodies.length} bodies on torsion springs, ${held}; ` +
    "the area of a disc is to scale with the inertia, unless that would be less than a dot."
  );
}
