"use strict";
// Draws the charts that a page carries as values (view/chart.py): uPlot has the axes, zoom and the cursor, the marks are
// drawn on its canvas. Drag to zoom, press twice to see everything again.
const Charts = (function () {
  const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  const ADAPTED = { "#1F2933": "ink", "#52606D": "muted", "#7B8794": "muted", "#C3CCD5": "line" };
  const LETTER = 12.5, LEFT = 88, RIGHT = 8, NAMES = 106, LINE = 15;
  const WHOLE = [1, 2, 5].flatMap((k) => [k, 10 * k, 100 * k, 1000 * k, 10000 * k]).sort((a, b) => a - b);
  const COLUMN = 560, MOST_ENLARGED = 2.2;  // pixels that fill the column beside a scene of 900 pixels

  // Colours of ink follow the page, light or dark; all others stay.
  const tint = (mark, otherwise) => (mark.color ? (ADAPTED[mark.color] ? style(ADAPTED[mark.color]) : mark.color) : style(otherwise));

  function painter(u) {
    const ctx = u.ctx, box = u.bbox, dpr = devicePixelRatio;
    const x = (v) => u.valToPos(v, "x", true), y = (v) => u.valToPos(v, "y", true);
    const fill = (color, alpha, draw) => { ctx.fillStyle = color; ctx.globalAlpha = alpha; draw(); ctx.globalAlpha = 1; };
    const stroke = (color, width, alpha, path, dashes = []) => {
      ctx.strokeStyle = color; ctx.lineWidth = width * dpr; ctx.globalAlpha = alpha; ctx.lineJoin = "round";
      ctx.setLineDash(dashes.map((d) => d * dpr)); ctx.stroke(path); ctx.setLineDash([]); ctx.globalAlpha = 1;
    };
    const line = (x0, y0, x1, y1) => { const path = new Path2D(); path.moveTo(x0, y0); path.lineTo(x1, y1); return path; };
    const across = (mark, alpha, color) => fill(color, alpha, () => ctx.fillRect(x(mark.start), box.top, Math.max(x(mark.end) - x(mark.start), dpr), box.height));

    function curve(mark, chosen) {
      const faded = mark.run !== undefined && chosen !== null && mark.run !== chosen;
      const picked = mark.run !== undefined && mark.run === chosen;
      const alpha = faded ? 0.16 : picked ? 1 : { run: 0.8, small: 0.6 }[mark.look] || 1;
      const color = tint(mark, mark.look === "other" ? "muted" : "ink");
      const size = { dots: 2.3, small: 1.5, rim: 3.1 }[mark.look];
      if (size) {
        return fill(color, alpha, () => mark.x.forEach((at, i) => {
          ctx.beginPath(); ctx.arc(x(at), y(mark.y[i]), size * dpr, 0, 2 * Math.PI); ctx.fill();
        }));
      }
      const path = new Path2D();
      mark.x.forEach((at, i) => path.lineTo(x(at), y(mark.y[i])));
      const width = picked ? 2.4 : { line: 2.4, other: 1.1, run: 1.5, trend: 1.6 }[mark.look];
      stroke(color, width, alpha, path);
    }

    const marks = {
      curve,
      area(mark) {
        const path = new Path2D();
        mark.x.forEach((at, i) => path.lineTo(x(at), y(mark.high[i])));
        for (let i = mark.x.length - 1; i >= 0; i--) path.lineTo(x(mark.x[i]), y(mark.low[i]));
        fill(tint(mark, "ink"), mark.look === "level" ? 0.75 : 0.28, () => ctx.fill(path));
      },
      span(mark) { across(mark, { shade: 0.17, hatched: 0.4, interval: 0.18 }[mark.look], tint(mark, "ink")); },
      range(mark) { fill(tint(mark, "ink"), 0.3, () => ctx.fillRect(box.left, y(mark.high), box.width, Math.max(y(mark.low) - y(mark.high), dpr))); },
      level(mark) {
        const path = line(box.left, y(mark.value), box.left + box.width, y(mark.value));
        mark.look === "zero" ? stroke(style("line"), 1, 1, path) : stroke(style("ink"), 1, 0.8, path, [5, 3]);
      },
      change(mark) { stroke(style("ink"), 1, 1, line(x(mark.at), box.top, x(mark.at), box.top + box.height), [5, 3]); },
      columns(mark) {
        fill(style("ink"), 1, () => mark.left.forEach((left, i) => {
          const from = x(left), top = y(mark.height[i]);
          ctx.fillRect(from, top, Math.max(x(mark.right[i]) - from, dpr), box.top + box.height - top);
        }));
      },
    };

    function words(mark) {
      const scale = u.scales.x;
      if (mark.side !== "edge" && (mark.x < scale.min || mark.x > scale.max)) return;
      ctx.font = `${mark.strong ? 650 : 400} ${LETTER * dpr}px system-ui, sans-serif`;
      ctx.textAlign = { middle: "center", left: "right", right: "left", edge: "left" }[mark.side];
      ctx.textBaseline = "middle";
      const gap = { middle: 0, left: -5, right: 5, edge: 5 }[mark.side] * dpr;
      const across = mark.side === "edge" ? box.left + box.width : x(mark.x);
      const up = mark.y === undefined ? box.top - (9 + LINE * mark.line) * dpr : y(mark.y);
      if (mark.color) {
        const half = ctx.measureText(mark.text).width / 2 + 3 * dpr;
        fill(mark.color, 1, () => ctx.fillRect(across - half, up - 8 * dpr, 2 * half, 16 * dpr));
      }
      fill(mark.color ? "#1f2933" : style(mark.strong ? "ink" : "muted"), 1, () => ctx.fillText(mark.text, across + gap, up));
    }
    // Draws within the panel, and leaves the canvas as uPlot knows it.
    function kept(draw, inside = true) {
      ctx.save();
      if (inside) { ctx.beginPath(); ctx.rect(box.left, box.top, box.width, box.height); ctx.clip(); }
      draw();
      ctx.restore();
    }
    return { marks, words, kept };
  }

  // Numbers of an axis, with as many decimals as tell them from each other.
  function numbers(u, splits) {
    const gap = Math.abs(splits[1] - splits[0]) || 1;
    let digits = 0;
    while (digits < 9 && Math.abs(gap * 10 ** digits - Math.round(gap * 10 ** digits)) > 1e-6 * gap * 10 ** digits) digits++;
    const texts = splits.map((v) => (Math.abs(v) < gap / 1e3 ? 0 : v).toFixed(digits));
    const short = texts.every((text) => text.length < 8) ? texts : splits.map((v) => (Math.abs(v) < gap / 1e3 ? "0" : v.toExponential(1)));
    return short.map((text) => text.replace(/^-/, "\u2212"));
  }

  let count = 0;

  // What belongs to one chart: its panels, the run that is shown alone, and the place of the player's line.
  function chartOf(element) {
    const value = JSON.parse(element.firstElementChild.textContent);
    const chart = { element, value, chosen: null, at: null, seek: null, panels: [] };
    const together = `chart ${count++}`;
    let zooming = false;
    const total = value.panels.reduce((sum, panel) => sum + panel.height, 0);
    const larger = value.fills ? Math.min(Math.max(COLUMN / total, 1), MOST_ENLARGED) : 1;
    const width = () => Math.max(element.clientWidth, 120);
    value.panels.forEach((panel, number) => {
      const isLast = number === value.panels.length - 1;
      const above = number ? 6 : 8 + LINE * value.lines;
      const height = larger * panel.height + above + (isLast ? 46 : 6);
      const cursor = document.createElement("i");
      cursor.className = "at";
      const label = (u) => {
        const ctx = u.ctx, dpr = devicePixelRatio, lines = panel.label.split("\n");
        ctx.save();
        ctx.font = `${LETTER * dpr}px system-ui, sans-serif`;
        const longest = Math.max(...lines.map((text) => ctx.measureText(text).width));
        // No longer than its panel.
        ctx.font = `${LETTER * dpr * Math.min(1, (u.bbox.height + 8 * dpr) / longest)}px system-ui, sans-serif`;
        ctx.fillStyle = style("muted"); ctx.textAlign = "center"; ctx.textBaseline = "middle";
        ctx.translate(8 * dpr, u.bbox.top + u.bbox.height / 2); ctx.rotate(-Math.PI / 2);
        lines.forEach((text, i) => ctx.fillText(text, 0, 13 * dpr * i));
        ctx.restore();
      };
      const axis = { values: numbers, stroke: () => style("muted"), font: `${LETTER}px system-ui, sans-serif`, ticks: { show: false }, grid: { show: false } };
      const below = { ...axis, size: isLast ? 22 : 0, show: isLast, label: value.x_label, labelSize: 18, labelFont: axis.font, labelGap: 0, gap: 4, space: 56 };
      if (value.whole) below.incrs = WHOLE;
      if (value.places.length) { below.splits = () => value.places.map((p) => p[0]); below.values = () => value.places.map((p) => p[1]); }
      const u = new uPlot({
        width: width(), height, padding: [above, value.names ? NAMES : RIGHT, 6, 0], legend: { show: false },
        scales: { x: { time: false, range: (u, low, high) => [low, high] }, y: { range: () => [panel.low, panel.high] } },
        axes: [below, { ...axis, size: LEFT, gap: 6, space: larger * panel.height < 80 ? 22 : 30 }],
        series: [{}, { show: false }],
        cursor: { y: false, points: { show: false }, drag: { x: true, y: false, dist: 6 }, sync: { key: together } },
        hooks: {
          drawClear: [(u) => { const p = painter(u); p.kept(() => panel.marks.forEach((m) => { if (["span", "range", "area"].includes(m.mark)) p.marks[m.mark](m); })); }],
          draw: [(u) => {
            const p = painter(u), drawn = panel.marks.filter((m) => ["curve", "level", "change", "columns"].includes(m.mark));
            // The chosen run lies on top.
            drawn.sort((a, b) => (a.run === chart.chosen) - (b.run === chart.chosen));
            p.kept(() => drawn.forEach((m) => p.marks[m.mark](m, chart.chosen)));
            p.kept(() => {
              u.ctx.strokeStyle = style("line"); u.ctx.lineWidth = devicePixelRatio;
              u.ctx.strokeRect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
              panel.marks.filter((m) => m.mark === "words").forEach(p.words);
              label(u);
            }, false);
            place();
          }],
          setScale: [(u, key) => {
            if (key !== "x" || zooming) return;
            zooming = true;
            for (const other of chart.panels) if (other.u !== u) other.u.setScale("x", { min: u.scales.x.min, max: u.scales.x.max });
            zooming = false;
          }],
        },
      }, [[value.first, value.last], [null, null]], element);
      const place = () => {
        const inside = chart.at !== null && chart.at >= u.scales.x.min && chart.at <= u.scales.x.max;
        cursor.style.visibility = inside ? "visible" : "hidden";
        if (inside) cursor.style.left = `${u.valToPos(chart.at, "x")}px`;
      };
      u.over.append(cursor);
      let pressed = null;
      u.over.addEventListener("mousedown", (event) => { pressed = event.clientX; });
      u.over.addEventListener("mouseup", (event) => {
        if (chart.seek && Math.abs(event.clientX - pressed) < 4) chart.seek(u.posToVal(event.offsetX, "x"));
      });
      chart.panels.push({ u, height, place });
    });
    chart.show = (at) => { chart.at = at; for (const panel of chart.panels) panel.place(); };
    chart.choose = (run) => { chart.chosen = run; for (const { u } of chart.panels) u.redraw(false, false); };
    new ResizeObserver(() => { for (const { u, height } of chart.panels) if (u.width !== width()) u.setSize({ width: width(), height }); }).observe(element);
    return chart;
  }
  function all() {
    const charts = [...document.querySelectorAll(".chart")].map(chartOf);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      for (const chart of charts) chart.choose(chart.chosen);
    });
    return charts;
  }
  return { all };
})();
