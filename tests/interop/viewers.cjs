// Films a PLY by another program's viewer of splats, at the viewer's own settings. Arguments: the browser, the folder
// of npm packages, the viewer (spark, gaussiansplats3d or playcanvas), the PLY, a transforms JSON, a folder for
// pictures.
"use strict";
const fs = require("node:fs");
const http = require("node:http");
const path = require("node:path");
const { chromium } = require("playwright-core");

const [browserPath, modules, viewer, plyPath, camerasPath, out] = process.argv.slice(2);
const NEAR = 0.05;
const FAR = 100;
// A viewer that has not come to rest by then never will.
const PATIENCE_MS = 180_000;
const SAME_TURNS = 4;
const MOST_TURNS = 40;
const TYPES = { ".js": "text/javascript", ".mjs": "text/javascript", ".wasm": "application/wasm" };

/** What a page of a viewer does: it leaves `show(camera)`, which draws once more. */
const PAGES = {
    spark: `
        import * as THREE from "three";
        import { SparkRenderer, SplatMesh } from "@sparkjsdev/spark";
        const renderer = new THREE.WebGLRenderer({ canvas, antialias: false });
        renderer.setSize(size.width, size.height, false);
        const scene = new THREE.Scene();
        const spark = new SparkRenderer({ renderer });
        scene.add(spark);
        const splats = new SplatMesh({ url: "/model.ply" });
        scene.add(splats);
        await splats.initialized;
        window.show = async (shot) => {
            const camera = perspective(THREE, shot);
            renderer.render(scene, camera);
            await drawn();
        };`,
    gaussiansplats3d: `
        import * as THREE from "three";
        import * as GaussianSplats3D from "@mkkellogg/gaussian-splats-3d";
        const renderer = new THREE.WebGLRenderer({ canvas, antialias: false });
        renderer.setSize(size.width, size.height, false);
        const root = document.body;
        const first = perspective(THREE, { fov_y_deg: 40, matrix: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 4, 0, 0, 0, 1] });
        const sceneRevealMode = GaussianSplats3D.SceneRevealMode.Instant;
        const ours = { selfDrivenMode: false, useBuiltInControls: false, rootElement: root, renderer, camera: first };
        const viewer = new GaussianSplats3D.Viewer({ ...ours, sceneRevealMode });
        await viewer.addSplatScene("/model.ply", { showLoadingUI: false });
        window.show = async (shot) => {
            place(first, shot);
            viewer.update();
            viewer.render();
            await drawn();
        };`,
    playcanvas: `
        import * as pc from "playcanvas";
        const app = new pc.Application(canvas, { graphicsDeviceOptions: { antialias: false } });
        app.setCanvasFillMode(pc.FILLMODE_NONE, size.width, size.height);
        app.setCanvasResolution(pc.RESOLUTION_FIXED, size.width, size.height);
        const asset = new pc.Asset("model", "gsplat", { url: "/model.ply" });
        app.assets.add(asset);
        await new Promise((loaded, failed) => {
            asset.ready(loaded);
            asset.on("error", failed);
            app.assets.load(asset);
        });
        const splats = new pc.Entity("splats");
        splats.addComponent("gsplat", { asset });
        app.root.addChild(splats);
        const eye = new pc.Entity("eye");
        eye.addComponent("camera", { clearColor: new pc.Color(0, 0, 0), nearClip: near, farClip: far });
        app.root.addChild(eye);
        app.start();
        window.show = async (shot) => {
            const m = shot.matrix;
            const columns = [0, 1, 2, 3].flatMap((column) => [0, 1, 2, 3].map((row) => m[4 * row + column]));
            const world = new pc.Mat4();
            world.set(columns);
            eye.setPosition(world.getTranslation());
            eye.setRotation(new pc.Quat().setFromMat4(world));
            eye.camera.fov = shot.fov_y_deg;
            await pause(400);
        };`,
};

/** The page around it, with what pages share. */
function page(size) {
    const imports = {
        three: "/modules/three/build/three.module.js",
        "three/addons/": "/modules/three/examples/jsm/",
        "@sparkjsdev/spark": "/modules/@sparkjsdev/spark/dist/spark.module.js",
        "@mkkellogg/gaussian-splats-3d": "/modules/@mkkellogg/gaussian-splats-3d/build/gaussian-splats-3d.module.js",
        playcanvas: "/modules/playcanvas/build/playcanvas.mjs",
        fflate: "/modules/fflate/esm/browser.js",
    };
    return `<!doctype html><meta charset="utf-8"><style>body { margin: 0; background: #000; overflow: hidden; }
        canvas { display: block; width: ${size.width}px; height: ${size.height}px; }</style>
        <script type="importmap">${JSON.stringify({ imports })}</script>
        <canvas id="picture" width="${size.width}" height="${size.height}"></canvas>
        <script type="module">
        const size = ${JSON.stringify(size)}, near = ${NEAR}, far = ${FAR};
        const canvas = document.getElementById("picture");
        const pause = (ms) => new Promise((done) => setTimeout(done, ms));
        // Until the picture is there: a context hands out no pixel before.
        const drawn = async () => {
            const gl = canvas.getContext("webgl2");
            gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
            await pause(50);
        };
        const place = (camera, shot) => {
            camera.fov = shot.fov_y_deg;
            camera.matrix.set(...shot.matrix);
            camera.matrix.decompose(camera.position, camera.quaternion, camera.scale);
            camera.updateProjectionMatrix();
            camera.updateMatrixWorld(true);
        };
        const perspective = (THREE, shot) => {
            const camera = new THREE.PerspectiveCamera(shot.fov_y_deg, size.width / size.height, near, far);
            place(camera, shot);
            return camera;
        };
        ${PAGES[viewer]}
        </script>`;
}

/** Hands out the page, the packages and the model to this machine alone. */
function serve(html) {
    const server = http.createServer((request, response) => {
        const asked = decodeURIComponent(new URL(request.url, "http://localhost").pathname);
        const inModules = path.join(modules, path.normalize(asked.replace(/^\/modules\//, "/")));
        const file = asked === "/model.ply" ? plyPath : inModules;
        // Shared memory, which a sorter wants, takes both.
        const isolated = {
            "Cross-Origin-Opener-Policy": "same-origin",
            "Cross-Origin-Embedder-Policy": "require-corp",
        };
        if (asked === "/") {
            response.writeHead(200, { ...isolated, "Content-Type": "text/html" }).end(html);
        } else if (fs.existsSync(file)) {
            const type = TYPES[path.extname(file)] ?? "application/octet-stream";
            response.writeHead(200, { ...isolated, "Content-Type": type, "Content-Length": fs.statSync(file).size });
            fs.createReadStream(file).pipe(response);
        } else {
            response.writeHead(404).end();
        }
    });
    return new Promise((ready) => server.listen(0, "127.0.0.1", () => ready(server)));
}

/** The picture that stays the same: viewers sort aside, and show what they have until then. */
async function atRest(tab, shot) {
    let [last, same] = [Buffer.alloc(0), 0];
    for (let turn = 0; turn < MOST_TURNS && same < SAME_TURNS; turn += 1) {
        await tab.evaluate((asked) => window.show(asked), shot);
        const picture = await tab.screenshot();
        same = picture.equals(last) ? same + 1 : 0;
        last = picture;
    }
    if (same < SAME_TURNS) throw new Error("the picture never comes to rest");
    return last;
}

async function main() {
    const cameras = JSON.parse(fs.readFileSync(camerasPath, "utf8"));
    const { w: width, h: height, fl_y: focal } = cameras.frames[0];
    const size = { width, height };
    const server = await serve(page(size));
    const args = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"];
    args.push("--force-color-profile=srgb");
    const browser = await chromium.launch({ executablePath: browserPath, args });
    const tab = await (await browser.newContext({ viewport: size, deviceScaleFactor: 1 })).newPage();
    tab.setDefaultTimeout(PATIENCE_MS);
    tab.on("pageerror", (error) => console.error(String(error)));
    tab.on("console", (message) => message.type() === "error" && console.error(message.text()));
    await tab.goto(`http://127.0.0.1:${server.address().port}/`);
    await tab.waitForFunction(() => window.show !== undefined);
    const fov_y_deg = (2 * Math.atan(height / (2 * focal)) * 180) / Math.PI;
    const shots = cameras.frames.map((frame) => ({ fov_y_deg, matrix: frame.transform_matrix.flat() }));
    // Some sort anew only when the camera moves once everything is there.
    await atRest(tab, shots.at(-1));
    for (const [number, shot] of shots.entries()) {
        const picture = await atRest(tab, shot);
        fs.writeFileSync(path.join(out, `${String(number).padStart(5, "0")}.png`), picture);
    }
    await browser.close();
    server.close();
}

main().catch((error) => {
    console.error(error);
    process.exit(1);
});
