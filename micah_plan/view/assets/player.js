"use strict";
// Rebuilds the scene from the commands that the page carries, and plays its animation.
(function () {
  const data = JSON.parse(document.getElementById("page-data").textContent);
  const viewer = new MeshCat.Viewer(document.getElementById("meshcat-pane"));
  window.viewer = viewer;  // for the console of the browser, and for tests
  const layer = (name) => viewer.scene_tree.find(data.layers[name] || ["meshcat", name]);

  // MeshCat fills the window; here the panel and the player take their share of it.
  const pane = document.getElementById("meshcat-pane");
  const resize = viewer.set_3d_pane_size.bind(viewer);
  let touched = false;
  viewer.set_3d_pane_size = () => {
    if (!touched) placeCamera();
    resize(pane.clientWidth, pane.clientHeight);
  };

  const dark = window.matchMedia("(prefers-color-scheme: dark)").matches;

  // What is drawn in the colour of ink or of faint lines on a light page is drawn light on a dark one.
  function adaptColors() {
    const swap = { 0x1f2933: 0xe8edf2, 0xc3ccd5: 0x46535f, 0x52606d: 0xaab4be };
    viewer.scene.traverse((object) => {
      const color = object.material && object.material.color;
      if (color && swap[color.getHex()] !== undefined) color.setHex(swap[color.getHex()]);
    });
  }

  // A line in every chart, at the row that is shown.
  const cursors = [...document.querySelectorAll("#charts .block")].map((block) => block.querySelector(".cursor"));
  function moveCursors(time) {
    data.charts.forEach((frames, i) => {
      if (!cursors[i] || !frames.length) return;
      const next = frames.findIndex((frame) => frame[0] >= time - 1e-6);
      const inside = next >= 0 && time >= frames[0][0] - 1e-6;
      cursors[i].setAttribute("visibility", inside ? "visible" : "hidden");
      if (!inside) return;
      const [a, b] = [frames[Math.max(next - 1, 0)], frames[next]];
      const x = a[1] + (b[0] > a[0] ? (time - a[0]) / (b[0] - a[0]) : 1) * (b[1] - a[1]);
      cursors[i].setAttribute("x1", x);
      cursors[i].setAttribute("x2", x);
    });
  }

  // Press or drag in a chart, and the player goes to that place.
  function setUpCharts(seek) {
    cursors.forEach((cursor, i) => {
      const frames = data.charts[i];
      if (!cursor || !frames.length) return;
      const drawing = cursor.ownerSVGElement;
      const go = (event) => {
        if (event.buttons !== 1) return;
        const x = new DOMPoint(event.clientX, event.clientY).matrixTransform(drawing.getScreenCTM().inverse()).x;
        const next = frames.findIndex((frame) => frame[1] >= x);
        if (next < 0) return seek(frames[frames.length - 1][0]);
        const [a, b] = [frames[Math.max(next - 1, 0)], frames[next]];
        seek(a[0] + (b[1] > a[1] ? (x - a[1]) / (b[1] - a[1]) : 1) * (b[0] - a[0]));
      };
      drawing.style.cursor = "col-resize";
      drawing.style.touchAction = "pan-y";
      for (const event of ["pointerdown", "pointermove"]) drawing.addEventListener(event, go);
    });
  }

  function setUpScene() {
    viewer.set_property(["Background"], "top_color", dark ? [0.07, 0.09, 0.11] : [0.86, 0.9, 0.94]);
    viewer.set_property(["Background"], "bottom_color", dark ? [0.13, 0.16, 0.19] : [0.985, 0.988, 0.992]);
    for (const path of [["Grid"], ["Axes"]]) viewer.set_property(path, "visible", false);
    for (const name of ["PointLightNegativeX", "PointLightPositiveX"]) {
      viewer.set_property(["Lights", name, "<object>"], "intensity", 0.22);
    }
    for (const text of data.commands) {
      viewer.handle_command_bytearray(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)));
    }
    if (dark) adaptColors();
    placeCamera();
    for (const event of ["pointerdown", "wheel"]) pane.addEventListener(event, () => { touched = true; }, true);
  }

  function placeCamera() {
    // z points up in the data, y in the viewer's own frame.
    const raised = (p) => [p[0], p[2], -p[1]];
    const camera = viewer.camera;
    camera.fov = data.camera.angle;
    camera.near = data.camera.near;
    camera.far = data.camera.far;
    camera.position.set(...raised(data.camera.position));
    viewer.controls.target.set(...raised(data.camera.target));
    // A tall window needs more distance to see the same width.
    const narrow = Math.min(1, pane.clientWidth / Math.max(1, pane.clientHeight));
    camera.position.sub(viewer.controls.target).divideScalar(Math.max(narrow, 0.2)).add(viewer.controls.target);
    viewer.controls.update();
    viewer.set_dirty();
  }

  function setUpLayers() {
    for (const box of document.querySelectorAll("input[data-layer]")) {
      const show = () => {
        layer(box.dataset.layer).set_property("visible", box.checked);
        viewer.set_dirty();
      };
      box.checked = !data.hidden.includes(box.dataset.layer);
      box.addEventListener("change", show);
      show();
    }
    document.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      for (const box of document.querySelectorAll("input[data-key]")) {
        if (box.dataset.key === event.key.toLowerCase()) box.click();
      }
    });
  }

  function setUpPlayer() {
    const slider = document.getElementById("time");
    if (!slider) return;
    const button = document.getElementById("play");
    const readout = document.getElementById("readout");
    const restAtEnd = 1.2;
    let time = 0, playing = false, before = null, rested = 0;

    // Activates the actions; from here on only seek() moves them, so that slider and scene cannot disagree.
    viewer.animator.play();
    viewer.animator.pause();

    function show(seconds) {
      time = Math.max(0, Math.min(data.duration, seconds));
      slider.value = time;
      viewer.animator.seek(time);
      moveCursors(time);
      let lines = [];
      for (const [start, text] of data.readouts) {
        if (start > time + 1e-9) break;
        lines = text;
      }
      readout.textContent = lines.join("\n");
    }
    function setPlaying(on) {
      if (on && time >= data.duration) time = 0;
      playing = on;
      before = null;
      rested = 0;
      document.body.classList.toggle("playing", on);
    }
    function tick(now) {
      if (playing) {
        const step = before === null ? 0 : (now - before) / 1000;
        if (time < data.duration) show(time + step);
        else if ((rested += step) > restAtEnd) { rested = 0; show(0); }
        before = now;
      }
      requestAnimationFrame(tick);
    }
    button.addEventListener("click", () => setPlaying(!playing));
    slider.addEventListener("input", () => { setPlaying(false); show(Number(slider.value)); });
    setUpCharts((seconds) => { setPlaying(false); show(seconds); });
    document.addEventListener("keydown", (event) => {
      if (event.target.tagName === "INPUT" && event.target.type !== "range") return;
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (event.key === " " && event.target !== button) setPlaying(!playing);
      else if (step) { setPlaying(false); show(time + step * data.duration / 60); }
      else if (event.key === "Home") { setPlaying(false); show(0); }
      else if (event.key === "End") { setPlaying(false); show(data.duration); }
      else return;
      event.preventDefault();
    });
    // "#t=0.5" opens the page at half time and still.
    const still = /t=([0-9.]+)/.exec(location.hash);
    show(still ? Number(still[1]) * data.duration : 0);
    setPlaying(!still && !window.matchMedia("(prefers-reduced-motion: reduce)").matches);
    requestAnimationFrame(tick);
  }

  setUpScene();
  setUpLayers();
  setUpPlayer();
  document.body.classList.add("ready");
})();
