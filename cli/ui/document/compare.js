"use strict";
// Lays the original over the film, and lets the slider say how much of it is seen.
for (const figure of document.querySelectorAll("[data-compare]")) {
    const slider = figure.querySelector("input");
    const move = () => figure.style.setProperty("--at", `${slider.value}%`);
    slider.addEventListener("input", move);
    move();
    figure.classList.add("live");
}
