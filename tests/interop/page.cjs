// What a browser says of a page of `verify --report`: at every width, in light and dark, by keyboard, without scripts,
// and on paper. Prints it as JSON. Arguments: the browser, the page.
"use strict";
const fs = require("node:fs");
const { pathToFileURL } = require("node:url");
const { chromium } = require("playwright-core");

const AXE = fs.readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");
const WIDTHS_PX = [400, 1600];
// The shorter side of what WCAG 2.5.8 calls a target, and a pixel for rounding.
const SLACK_PX = 1;

const [browserPath, pagePath] = process.argv.slice(2);
const url = pathToFileURL(pagePath).href;

/** Opens the page and notes what it complains of and asks for. */
async function open(browser, options, look) {
    const context = await browser.newContext(options);
    const page = await context.newPage();
    const noted = { console: [], requests: [] };
    page.on("console", (message) => ["error", "warning"].includes(message.type()) && noted.console.push(message.text()));
    page.on("pageerror", (error) => noted.console.push(String(error)));
    page.on("request", (request) => {
        const asked = request.url();
        if (asked !== url && !asked.startsWith("data:")) noted.requests.push(asked);
    });
    await page.goto(url, { waitUntil: "load" });
    const seen = await look(page);
    await context.close();
    return { ...noted, ...seen };
}

/** Width that the page takes, and what axe-core finds that is serious. */
async function looks(page) {
    const widest = await page.evaluate(() => document.documentElement.scrollWidth - window.innerWidth);
    await page.evaluate(AXE);
    const found = await page.evaluate(() => axe.run(document, { resultTypes: ["violations"] }));
    const serious = found.violations.filter((violation) => ["serious", "critical"].includes(violation.impact));
    const told = serious.map(({ id, nodes }) => `${id}: ${nodes.map((node) => node.html).join(" ")}`);
    return { overflows: widest > SLACK_PX, axe: told, rules: found.passes.length };
}

/** What the keyboard reaches: the slider moves, and the numbers open. */
async function keys(page) {
    const reached = [];
    const stops = await page.evaluate(() => document.querySelectorAll("input, summary, pre[tabindex]").length);
    const at = () => page.evaluate(() => {
        const figure = document.activeElement.closest("[data-compare]");
        return figure && getComputedStyle(figure.querySelector(".original")).clipPath;
    });
    for (let stop = 0; stop < stops; stop += 1) {
        await page.keyboard.press("Tab");
        const tag = await page.evaluate(() => document.activeElement.tagName.toLowerCase());
        const outline = await page.evaluate(() => getComputedStyle(document.activeElement).outlineStyle);
        const before = await at();
        if (tag === "input") await page.keyboard.press("ArrowRight");
        if (tag === "summary") await page.keyboard.press("Enter");
        const opened = await page.evaluate(() => document.activeElement.parentElement.open === true);
        reached.push({ tag, outline, moved: before !== (await at()), opened });
    }
    return { stops: reached };
}

/** Both pictures of each pair beside each other: what is seen without scripts and on paper. */
async function apart(page) {
    return {
        apart: await page.evaluate(() => [...document.querySelectorAll("[data-compare]")].map((figure) => {
            const [film, original] = [...figure.querySelectorAll(".pair img")].map((image) => image.getBoundingClientRect());
            const slider = figure.querySelector("input").getBoundingClientRect();
            return (film.right <= original.left || film.bottom <= original.top) && slider.width === 0;
        })),
    };
}

async function main() {
    const browser = await chromium.launch({ executablePath: browserPath, args: ["--no-sandbox"] });
    const result = { views: [] };
    for (const width of WIDTHS_PX) {
        for (const colorScheme of ["light", "dark"]) {
            const options = { viewport: { width, height: 900 }, colorScheme };
            result.views.push({ width, colorScheme, ...(await open(browser, options, looks)) });
        }
    }
    result.keyboard = await open(browser, {}, keys);
    result.scriptless = await open(browser, { javaScriptEnabled: false }, async (page) => {
        // Playwright itself still looks, though the page may not run anything.
        return { text: await page.locator("body").innerText(), images: await page.locator("img").count() };
    });
    result.paper = await open(browser, {}, async (page) => {
        await page.emulateMedia({ media: "print" });
        return apart(page);
    });
    result.elements = await open(browser, {}, (page) => page.evaluate(() => ({
        scripts: document.scripts.length,
        handlers: [...document.querySelectorAll("*")].filter((e) => [...e.attributes].some((a) => a.name.startsWith("on"))).length,
        broken: [...document.images].filter((image) => image.naturalWidth === 0).length,
        title: document.title,
    })));
    await browser.close();
    console.log(JSON.stringify(result));
}

main().catch((error) => {
    console.error(error);
    process.exit(1);
});
