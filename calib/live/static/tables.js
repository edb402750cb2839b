// Rows of the tables, the newest first.
const fixed = (value, digits) => (value === null || value === undefined ? "∞" : value.toFixed(digits));

export function fillPositions(table, rows) {
  fill(table, rows, (one) => one.xyz_mm
    ? [one.id, ...one.xyz_mm.map((v) => fixed(v, 2)), fixed(one.u_mm[2], 2),
      `${fixed(one.z95_mm[0], 2)} – ${fixed(one.z95_mm[1], 2)}`, fixed(one.alpha2_deg, 4), one.moves, one.status]
    : [one.id, "", "", "", "", "", "", "", one.status]);
}

export function fillLengths(table, rows) {
  fill(table, rows, (one) => one.length_mm !== undefined
    ? [one.id, one.from, one.to, fixed(one.length_mm, 2), fixed(one.u_mm, 2), one.status]
    : [one.id, one.from, one.to, "", "", one.status]);
}

function fill(table, rows, cells) {
  const key = `${rows.length} ${rows.length ? rows[rows.length - 1].id : ""}`;
  if (!rows.length || table.dataset.key === key) return;
  table.dataset.key = key;
  table.tBodies[0].replaceChildren(...[...rows].reverse().map((one) => {
    const row = document.createElement("tr");
    for (const text of cells(one)) row.insertCell().textContent = text;
    if (one.status !== "ok") row.lastChild.className = "bad";
    return row;
  }));
}
