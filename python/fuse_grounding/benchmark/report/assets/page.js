"use strict";

// Tables: a click on a head sorts by it, another one the other way round; rows with a note stay last.
for (const table of document.querySelectorAll(".table table")) {
  const heads = [...table.tHead.rows[table.tHead.rows.length - 1].cells];
  const body = table.tBodies[0];
  if (body.rows.length < 2) continue;
  heads.forEach((head, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const down = head.getAttribute("aria-sort") === "ascending";
      heads.forEach((other) => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      body.append(...sorted([...body.rows], column, down ? -1 : 1));
    });
  });
}

function sorted(rows, column, direction) {
  const key = (row) => {
    if (row.classList.contains("noted") || !row.cells[column]) return null;
    const value = row.cells[column].dataset.v;
    if (value === undefined) return null;
    const number = Number(value);
    return Number.isNaN(number) ? value : number;
  };
  const compare = (a, b) => {
    if (a === null || b === null) return (a === null) - (b === null);
    if (typeof a === "number" && typeof b === "number") return direction * (a - b);
    return direction * String(a).localeCompare(String(b));
  };
  return rows
    .map((row, place) => ({ row, place, key: key(row) }))
    .sort((a, b) => compare(a.key, b.key) || a.place - b.place)
    .map((entry) => entry.row);
}

// Episodes: one view at a time, by button, slider or arrow key. Without scripts they stand below each other.
for (const strip of document.querySelectorAll(".strip")) {
  const frames = [...strip.querySelectorAll(".frame")];
  if (frames.length < 2) continue;
  const bar = document.createElement("div");
  bar.className = "stepper";
  const slider = document.createElement("input");
  Object.assign(slider, { type: "range", min: 0, max: frames.length - 1, step: 1, value: 0 });
  slider.setAttribute("aria-label", "view");
  let at = 0;
  const show = (place) => {
    at = Math.max(0, Math.min(frames.length - 1, place));
    slider.value = at;
    frames.forEach((frame, i) => frame.toggleAttribute("hidden", i !== at));
    back.disabled = at === 0;
    on.disabled = at === frames.length - 1;
  };
  const step = (words, by) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = words;
    button.addEventListener("click", () => show(at + by));
    return button;
  };
  const back = step("‹ previous", -1);
  const on = step("next ›", 1);
  slider.addEventListener("input", () => show(Number(slider.value)));
  strip.addEventListener("keydown", (event) => {
    if (event.target === slider) return;
    if (event.key === "ArrowRight") show(at + 1);
    else if (event.key === "ArrowLeft") show(at - 1);
    else return;
    event.preventDefault();
  });
  bar.append(back, slider, on);
  strip.querySelector(".frames").before(bar);
  show(0);
}
