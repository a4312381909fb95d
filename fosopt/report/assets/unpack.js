// Details as they were before they were packed: see pack.py.

function unpackedCurve(curve) {
  if (typeof curve?.[4] !== "string") return curve;
  const [size, logarithmic, low, high, text] = curve;
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const scale = (high - low) / (256 ** size - 1);
  return Array.from({ length: bytes.length / size }, (_, index) => {
    let whole = 0;
    for (let k = size - 1; k >= 0; k -= 1) whole = 256 * whole + bytes[size * index + k];
    const value = low + whole * scale;
    return logarithmic ? 10 ** value : value;
  });
}

function unpackedTable(table) {
  return Object.fromEntries(Object.entries(table).map(([name, curve]) => [name, unpackedCurve(curve)]));
}

function unpackedRows({ names, rows }) {
  return rows.map((row) => Object.fromEntries(names.map((name, index) => [name, row[index]])));
}

let opened = {};

// Only the point that is looked at is unpacked.
function detailOf(point) {
  if (opened.point === point) return opened.detail;
  const detail = { ...(point.detail ?? {}) };
  for (const name of ["bode", "spectrum", "cumulative", "step"]) {
    if (detail[name]) detail[name] = unpackedTable(detail[name]);
  }
  if (detail.by_mode)
    detail.by_mode = { ...detail.by_mode, cumulative: unpackedTable(detail.by_mode.cumulative) };
  if (detail.modes?.names) detail.modes = unpackedRows(detail.modes);
  if (detail.truss) detail.truss = { ...run.trusses[detail.truss.of], areas: detail.truss.areas };
  opened = { point, detail };
  return detail;
}
