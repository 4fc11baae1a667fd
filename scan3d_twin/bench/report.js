"use strict";

/* Tables: a click on a column's name sorts by it; numbers by value, all else as text. */
const NUMBER = /^[\u00d7\s]*([+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?)/i;

function sortKey(row, column) {
  const text = row.cells[column].textContent.trim();
  const found = NUMBER.exec(text);
  return { text, value: found ? Number(found[1]) : NaN, none: text === "\u2013" };
}

function compareKeys(a, b, numbers) {
  return numbers ? a.value - b.value : a.text.localeCompare(b.text, "en", { numeric: true });
}

function sortTable(table, column, sign) {
  const keyed = [...table.tBodies[0].rows].map((row) => [sortKey(row, column), row]);
  const numbers = keyed.every(([key]) => key.none || !Number.isNaN(key.value));
  // Rows without a value stay last in both directions
  keyed.sort(([a], [b]) => a.none - b.none || (a.none ? 0 : sign * compareKeys(a, b, numbers)));
  table.tBodies[0].append(...keyed.map(([, row]) => row));
}

for (const table of document.querySelectorAll("table")) {
  const names = [...table.tHead.rows[0].cells];
  names.forEach((name, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = name.textContent;
    name.replaceChildren(button);
    button.addEventListener("click", () => {
      const up = name.getAttribute("aria-sort") !== "ascending";
      for (const each of names) each.removeAttribute("aria-sort");
      name.setAttribute("aria-sort", up ? "ascending" : "descending");
      sortTable(table, column, up ? 1 : -1);
    });
  });
}

/* Figures: the nearest dot within reach is the one meant; a figure is one stop of the Tab key. */
const REACH = 24;

function placeOf(link) {
  const box = link.querySelector("circle").getBoundingClientRect();
  return [box.x + box.width / 2, box.y + box.height / 2];
}

function nearest(links, x, y) {
  let best = null;
  let least = REACH;
  for (const link of links) {
    const [px, py] = placeOf(link);
    const distance = Math.hypot(px - x, py - y);
    if (distance < least) [best, least] = [link, distance];
  }
  return best;
}

for (const figure of document.querySelectorAll(".plot")) {
  const links = [...figure.querySelectorAll("svg a")];
  const words = figure.querySelector(".pointed");
  if (!links.length) {
    words.remove();
    continue;
  }
  const drawing = figure.querySelector("svg");
  // Arrows go from left to right
  const order = links.map((link) => [placeOf(link), link]).sort(([a], [b]) => a[0] - b[0] || a[1] - b[1]);
  const ring = order.map(([, link]) => link);

  const point = (link) => {
    for (const each of links) each.classList.toggle("near", each === link);
    words.textContent = link ? link.querySelector("title").textContent : "";
  };
  const stop = (link) => {
    for (const each of links) each.setAttribute("tabindex", each === link ? "0" : "-1");
  };
  stop(ring[0]);

  drawing.addEventListener("pointermove", (event) => {
    const link = nearest(links, event.clientX, event.clientY);
    drawing.style.cursor = link ? "pointer" : "";
    point(link);
  });
  drawing.addEventListener("pointerleave", () => point(null));
  drawing.addEventListener("click", (event) => {
    // Enter on a dot is a click without a place
    const link = event.detail === 0 ? null : nearest(links, event.clientX, event.clientY);
    if (!link) return;
    event.preventDefault();
    location.hash = link.getAttribute("href");
  });
  for (const link of links) link.addEventListener("focus", () => { stop(link); point(link); });
  drawing.addEventListener("keydown", (event) => {
    const turn = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
    const at = ring.indexOf(document.activeElement);
    if (!turn || at < 0) return;
    event.preventDefault();
    ring[(at + turn + ring.length) % ring.length].focus();
  });
}

/* The line that a dot leads to takes the focus, so that Tab goes on from there. */
window.addEventListener("hashchange", () => {
  const row = document.getElementById(decodeURIComponent(location.hash.slice(1)));
  if (!row || row.tagName !== "TR") return;
  row.tabIndex = -1;
  row.focus();
});
