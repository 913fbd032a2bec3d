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

  // The charts, by their place among the blocks; a line in each of them at the row that is shown.
  const blocks = [...document.querySelectorAll("#charts .block")];
  const charts = blocks.length ? Charts.all() : [];
  window.charts = charts;
  const chartOf = (i) => charts.find((chart) => blocks[i].contains(chart.element));

  // The place between two of the frames (from, to), by the first of their numbers or the second.
  function between(frames, value, from, to) {
    const next = frames.findIndex((frame) => frame[from] >= value - 1e-6);
    if (next < 0 || value < frames[0][from] - 1e-6) return null;
    const [a, b] = [frames[Math.max(next - 1, 0)], frames[next]];
    return a[to] + (b[from] > a[from] ? (value - a[from]) / (b[from] - a[from]) : 1) * (b[to] - a[to]);
  }

  function moveCursors(time) {
    data.charts.forEach((frames, i) => {
      const chart = chartOf(i);
      if (chart && frames.length) chart.show(between(frames, time, 0, 1));
    });
  }

  // Press in a chart, and the player goes to that place.
  function setUpCharts(seek) {
    data.charts.forEach((frames, i) => {
      const chart = chartOf(i);
      if (!chart || !frames.length) return;
      const last = frames[frames.length - 1];
      chart.seek = (x) => seek(x >= last[1] ? last[0] : between(frames, Math.max(x, frames[0][1]), 1, 0));
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
    for (const event of ["pointerdown", "wheel"]) pane.addEventListener(event, () => { touched = true; }, true);
  }

  // z points up in the data, y in the viewer's own frame.
  const raised = (p) => new MeshCat.THREE.Vector3(p[0], p[2], -p[1]);
  const best = raised(data.camera.position).sub(raised(data.camera.target));
  const ways = { front: raised([0, -1, 0.12]), side: raised([1, 0, 0.12]), top: raised([0, -0.02, 1]) };
  let view = "whole", followed = null;

  // The box around what moves: the object itself, or what is shown of the chosen run.
  function movingBox() {
    const nodes = [];
    const collect = (node, depth) => {
      for (const [name, child] of Object.entries(node.children || {})) {
        if (name === "<object>" || name === "fixed" || name === "track" || !child.object.visible) continue;
        depth > 0 ? collect(child, depth - 1) : nodes.push(child.object);
      }
    };
    collect(viewer.scene_tree.find(["meshcat", "object"]), 0);
    if (!nodes.length) collect(viewer.scene_tree.find(["meshcat", "runs"]), 1);
    const box = new MeshCat.THREE.Box3();
    for (const node of nodes) { node.updateWorldMatrix(true, true); box.expandByObject(node); }
    return box;
  }

  function motionBox() {
    const box = new MeshCat.THREE.Box3();
    for (const share of [0, 0.25, 0.5, 0.75, 1]) {
      if (data.duration > 0) viewer.animator.seek(share * data.duration);
      box.union(movingBox());
    }
    seekAgain();
    return box;
  }

  function placeCamera() {
    const camera = viewer.camera, target = viewer.controls.target;
    camera.fov = data.camera.angle;
    camera.near = data.camera.near;
    camera.far = data.camera.far;
    // A tall window needs more distance to see the same width.
    const narrow = Math.max(0.2, Math.min(1, pane.clientWidth / Math.max(1, pane.clientHeight)));
    const box = view === "motion" ? motionBox() : view === "object" ? movingBox() : null;
    let way = (ways[view] || best).clone(), distance = best.length();
    target.copy(raised(data.camera.target));
    if (box && !box.isEmpty()) {
      const ball = box.getBoundingSphere(new MeshCat.THREE.Sphere());
      target.copy(ball.center);
      const room = view === "object" ? 1.5 : 1.1;
      distance = (room * Math.max(ball.radius, 1e-3)) / Math.sin((camera.fov * Math.PI) / 360);
      camera.near = Math.min(camera.near, distance / 200);
    }
    followed = view === "object" ? target.clone() : null;
    camera.position.copy(target).addScaledVector(way.normalize(), distance / narrow);
    viewer.controls.update();
    viewer.set_dirty();
  }

  // In the view of the object the camera goes along with it.
  function follow() {
    if (!followed) return;
    const center = movingBox().getCenter(new MeshCat.THREE.Vector3());
    const step = center.clone().sub(followed);
    viewer.camera.position.add(step);
    viewer.controls.target.add(step);
    followed = center;
    viewer.controls.update();
  }

  function setUpViews() {
    const choose = (name) => {
      view = name;
      touched = false;
      for (const button of document.querySelectorAll("#tools [data-view]")) {
        button.setAttribute("aria-pressed", String(button.dataset.view === name));
      }
      placeCamera();
    };
    const fold = () => {
      document.body.classList.toggle("folded");
      viewer.set_3d_pane_size();
    };
    for (const button of document.querySelectorAll("#tools [data-view]")) {
      button.addEventListener("click", () => choose(button.dataset.view));
    }
    document.getElementById("fold").addEventListener("click", fold);
    const keys = { w: "whole", m: "motion", o: "object" };
    document.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "SELECT") return;
      const key = event.key.toLowerCase();
      if (keys[key]) choose(keys[key]);
      if (key === "p") fold();
    });
    // "#stage" is the page for a video: no panels, no buttons.
    if (/stage/.test(location.hash)) document.body.classList.add("folded", "stage");
    viewer.set_3d_pane_size();
    // Where no body of the object stands, such as one in a hand, its motion fills the picture, not its surroundings.
    const standing = Object.keys(viewer.scene_tree.find(["meshcat", "object"]).children).includes("fixed");
    const motion = motionBox().getBoundingSphere(new MeshCat.THREE.Sphere()).radius;
    const whole = best.length() * Math.sin((data.camera.angle * Math.PI) / 360);
    const asked = /view=(\w+)/.exec(location.hash);
    choose(asked ? asked[1] : !standing && data.duration > 0 && motion > 0 && whole > 1.4 * motion ? "motion" : "whole");
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

  // Which run is shown beside the plan or the model; null for all.
  let chosen = null;
  let showAgain = () => {}, seekAgain = () => {};
  function setUpRuns() {
    const list = document.getElementById("run");
    if (!list) return;
    const words = document.getElementById("run-words");
    const choose = () => {
      chosen = list.value === "all" ? null : Number(list.value);
      data.runs.forEach((run, i) => {
        const shown = chosen === null || chosen === i;
        if (run.path.length) viewer.scene_tree.find(run.path).set_property("visible", shown);
      });
      for (const chart of charts) chart.choose(chosen === null ? null : data.runs[chosen].drawn);
      words.replaceChildren(...(chosen === null ? [] : data.runs[chosen].words).map((text) => {
        const line = document.createElement("p");
        line.textContent = text;
        return line;
      }));
      viewer.set_dirty();
      showAgain();
    };
    list.addEventListener("change", choose);
    document.addEventListener("keydown", (event) => {
      if (event.key.toLowerCase() !== "r" || event.ctrlKey || event.metaKey || event.altKey) return;
      list.selectedIndex = (list.selectedIndex + 1) % list.options.length;
      choose();
    });
    choose();
  }

  // A slider between two of what is drawn of each run: in the middle both are seen.
  function setUpFade() {
    const slider = document.getElementById("fade");
    if (!slider) return;
    const fade = () => {
      const shares = [Math.min(1, 2 - 2 * slider.value), Math.min(1, 2 * slider.value)];
      for (const run of data.runs) data.fade.forEach((name, i) => {
        const drawn = viewer.scene_tree.find([...run.path, name]).object;
        drawn.visible = shares[i] > 0;
        drawn.traverse((object) => {
          if (!object.material) return;
          object.userData.opacity ??= object.material.opacity;
          object.material.opacity = object.userData.opacity * shares[i];
          object.material.transparent = true;
        });
      });
      viewer.set_dirty();
    };
    slider.addEventListener("input", fade);
    fade();
  }

  function linesAt(readouts, time) {
    let lines = [];
    for (const [start, text] of readouts) {
      if (start > time + 1e-9) break;
      lines = text;
    }
    return lines;
  }

  // The box and the chip of the mode at a time are filled, and what moves of the object takes on a share of its colour.
  const boxes = [...document.querySelectorAll(".diagram .mode")];
  const chips = [...document.querySelectorAll(".chips li")];
  function showMode(time) {
    const begun = data.modes.filter(([start]) => start <= time + 1e-9);
    const mode = begun.length ? begun[begun.length - 1][1] : null;
    boxes.forEach((box) => box.classList.toggle("now", box.dataset.mode === mode));
    chips.forEach((chip, i) => chip.classList.toggle("now", i === begun.length - 1));
    const isMode = begun.length && !(chips.length && begun.length > chips.length);  // behind a plan it is released
    if (data.tinted) tint(isMode ? begun[begun.length - 1][2] : null);
  }
  const tintShare = 0.35;
  let tinted = null;
  function tint(color) {
    if (color === tinted) return;
    tinted = color;
    for (const [name, part] of Object.entries(viewer.scene_tree.find(["meshcat", "object"]).children)) {
      if (name !== "fixed") part.object.traverse((object) => {
        if (!object.material) return;
        const own = (object.userData.color ??= object.material.color.clone());
        object.material.color.copy(own);
        if (color) object.material.color.lerp(own.clone().set(color), tintShare);
      });
    }
    viewer.set_dirty();
  }

  // What the camera saw at a time of the player.
  const picture = document.getElementById("picture");
  function showPicture(time) {
    if (!picture) return;
    let source = data.pictures[0][1];
    for (const [start, each] of data.pictures) {
      if (start > time + 1e-9) break;
      source = each;
    }
    if (picture.src !== source) picture.src = source;
  }

  function setUpPlayer() {
    const slider = document.getElementById("time");
    if (!slider) return;
    const button = document.getElementById("play");
    const readout = document.getElementById("readout");
    const restAtEnd = 1.2;
    let time = 0, playing = false, before = null, rested = 0;

    // What is shown of a run stands beside the rest, and has its place from the beginning, so that the slider stays.
    const sources = [];
    if (data.readouts.length) sources.push(() => data.readouts);
    if (data.runs.some((run) => run.readouts.length)) sources.push(() => (chosen === null ? [] : data.runs[chosen].readouts));
    readout.style.setProperty("--columns", Math.max(sources.length, 1));
    const texts = sources.map(() => readout.appendChild(document.createElement("div")));

    // Activates the actions; from here on only seek() moves them, so that slider and scene cannot disagree.
    viewer.animator.play();
    viewer.animator.pause();

    const clock = document.getElementById("clock");
    const speed = document.getElementById("speed");
    seekAgain = () => viewer.animator.seek(time);

    function show(seconds) {
      time = Math.max(0, Math.min(data.duration, seconds));
      slider.value = time;
      seekAgain();
      follow();
      clock.textContent = `${time.toFixed(1)} of ${data.duration.toFixed(1)} s`;
      moveCursors(time);
      showMode(time);
      showPicture(time);
      sources.forEach((source, i) => { texts[i].textContent = linesAt(source(), time).join("\n"); });
    }
    showAgain = () => show(time);
    window.player = { show, duration: data.duration };  // for recordings
    function setPlaying(on) {
      if (on && time >= data.duration) time = 0;
      playing = on;
      before = null;
      rested = 0;
      document.body.classList.toggle("playing", on);
    }
    function tick(now) {
      if (playing) {
        const step = before === null ? 0 : (Number(speed.value) * (now - before)) / 1000;
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
      if (event.target.tagName === "SELECT" || (event.target.tagName === "INPUT" && event.target.type !== "range")) return;
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
    const still = /\bt=([0-9.]+)/.exec(location.hash);
    show(still ? Number(still[1]) * data.duration : 0);
    setPlaying(!still && !window.matchMedia("(prefers-reduced-motion: reduce)").matches);
    requestAnimationFrame(tick);
  }

  setUpScene();
  setUpLayers();
  setUpRuns();
  setUpFade();
  setUpPlayer();
  setUpViews();
  document.body.classList.add("ready");
})();
