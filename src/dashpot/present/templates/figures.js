// Figures of a report answer the mouse and the keyboard: values under the pointer, zoom by dragging.
// Works on matplotlib's SVG and its attribute data-panels; without this script the figures are as on paper.
(() => {
  'use strict';
  const NS = 'http://www.w3.org/2000/svg', INK = '#1f2933', GRID = '#e4e7eb', LEAST_DRAG = 6;

  // ---- numbers and axes

  function told(value) {
    if (value === 0) return '0';
    const size = Math.abs(value);
    const text = size < 1e-3 || size >= 1e5 ? value.toExponential(3) : String(Number(value.toPrecision(4)));
    return text.replaceAll('-', '\u2212');
  }
  const withUnit = (text, unit) => (unit ? `${text} ${unit}` : text);

  // Functions between values and the even coordinate along an axis.
  function scaleOf(axis) {
    if (axis.scale === 'log') return { to: Math.log10, from: t => 10 ** t };
    if (axis.scale !== 'symlog') return { to: v => v, from: t => t };
    const limit = axis.linear, part = 1 / 0.9;  // matplotlib's symlog of base 10
    return {
      to: v => Math.abs(v) <= limit ? v * part : Math.sign(v) * limit * (part + Math.log10(Math.abs(v) / limit)),
      from: t => Math.abs(t) <= limit * part ? t / part : Math.sign(t) * limit * 10 ** (Math.abs(t) / limit - part),
    };
  }
  function steps(low, high, most) {
    const raw = (high - low) / most, ten = 10 ** Math.floor(Math.log10(raw));
    const step = ten * [1, 2, 5, 10].find(m => m * ten >= raw);
    const found = [];
    for (let k = Math.ceil(low / step); k * step <= high * (1 + 1e-12); k++) found.push(Number((k * step).toPrecision(12)));
    return found;
  }
  function ticks(axis, low, high, most) {  // low, high in values
    if (axis.scale !== 'log' || high < 10 * low) return steps(low, high, most);
    const found = [];
    for (let p = Math.floor(Math.log10(low)); p <= Math.log10(high); p++)
      for (const m of high < 1000 * low ? [1, 2, 5] : [1]) if (m * 10 ** p >= low && m * 10 ** p <= high) found.push(m * 10 ** p);
    return found;
  }

  // ---- one panel: the axes of a figure

  function panelOf(svg, spec) {
    const group = svg.querySelector(`[id="${spec.id}"]`), [left, top, width, height] = spec.box;
    const sx = scaleOf(spec.x), sy = scaleOf(spec.y);
    const whole = { x: spec.x.limits.map(sx.to), y: spec.y.limits.map(sy.to) };
    const view = { x: [...whole.x], y: [...whole.y] };
    const px = (v, seen = view) => left + (sx.to(v) - seen.x[0]) / (seen.x[1] - seen.x[0]) * width;
    const py = (v, seen = view) => top + height - (sy.to(v) - seen.y[0]) / (seen.y[1] - seen.y[0]) * height;
    const panel = { spec, group, left, top, width, height, whole, view, px, py, sx, sy };
    panel.xOf = (p, seen = view) => sx.from(seen.x[0] + (p - left) / width * (seen.x[1] - seen.x[0]));
    panel.yOf = (p, seen = view) => sy.from(seen.y[0] + (top + height - p) / height * (seen.y[1] - seen.y[0]));
    panel.contains = (x, y) => x >= left && x <= left + width && y >= top && y <= top + height;
    return panel;
  }

  const numbersOf = d => d.match(/[A-Za-z]|-?[\d.]+(?:e[-+]?\d+)?/g) || [];

  // Corners of a drawn line or band, in the coordinates of the figure before any zoom.
  function cornersOf(panel, id) {
    panel.corners ??= {};
    if (panel.corners[id]) return panel.corners[id];
    const group = panel.group.querySelector(`[id="${id}"]`), runs = [];
    for (const path of group ? group.querySelectorAll('path') : []) {
      const use = path.closest('defs') && group.querySelector('use');
      const dx = use ? Number(use.getAttribute('x')) : 0, dy = use ? Number(use.getAttribute('y')) : 0;
      let pair = [];
      for (const part of numbersOf(path.dataset.d ?? path.getAttribute('d'))) {
        if (part === 'M') runs.push([]);
        if (/[A-Za-z]/.test(part)) continue;
        pair.push(Number(part));
        if (pair.length === 2) { runs.at(-1).push([pair[0] + dx, pair[1] + dy]); pair = []; }
      }
    }
    return (panel.corners[id] = runs);
  }
  // Values at which a line or the edge of a band crosses x.
  function crossings(panel, id, x) {
    const at = panel.px(x, panel.whole), found = [];
    for (const run of cornersOf(panel, id))
      for (let k = 1; k < run.length; k++) {
        const [a, b] = [run[k - 1], run[k]];
        if ((a[0] - at) * (b[0] - at) > 0 || a[0] === b[0]) continue;
        found.push(panel.yOf(a[1] + (at - a[0]) / (b[0] - a[0]) * (b[1] - a[1]), panel.whole));
      }
    return found;
  }

  // ---- what is told

  function nearest(panel, x, y) {
    let best = null, least = Infinity;
    for (const shown of panel.spec.series.filter(s => s.kind === 'points'))
      shown.x.forEach((value, k) => {
        if (value === null || shown.y[k] === null) return;
        const [p, q] = [panel.px(value), panel.py(shown.y[k])];
        if (!panel.contains(p, q)) return;
        const far = panel.spec.at ? Math.hypot(p - x, q - y) : Math.abs(p - x) + 1e-3 * Math.abs(q - y);
        if (far < least) { least = far; best = { x: value, y: shown.y[k], k }; }
      });
    return best;
  }
  function tell(panel, x, y) {  // lines of text, and the value of x that they are for
    const spec = panel.spec;
    if (spec.cells) {
      const { rows, columns, values } = spec.cells;
      const row = Math.min(rows.length - 1, Math.floor((y - panel.top) / panel.height * rows.length));
      const column = Math.min(columns.length - 1, Math.floor((x - panel.left) / panel.width * columns.length));
      const value = values[row][column];
      return { lines: [`${rows[row]}, ${columns[column]}`, withUnit(value === null ? '\u2013' : told(value), spec.y.unit)] };
    }
    const point = nearest(panel, x, y);
    if (spec.at) {
      if (!point) return null;
      return { lines: [spec.at[point.k], `${told(point.x)} ${point.y < 0 ? '\u2212' : '+'} ${told(Math.abs(point.y))} i` +
        (spec.y.unit ? ` ${spec.y.unit}` : '')], point };
    }
    const at = point ? point.x : panel.xOf(x), lines = [`${withUnit(told(at), spec.x.unit)}`];
    for (const shown of spec.series) {
      if (shown.kind === 'points') shown.x.forEach((value, k) => {
        if (value !== at || shown.y[k] === null) return;
        const around = shown.low ? ` (${told(shown.low[k])} \u2026 ${told(shown.high[k])})` : '';
        lines.push(`${shown.name}: ${withUnit(told(shown.y[k]), spec.y.unit)}${around}`);
      });
      else {
        const values = crossings(panel, shown.id, at);
        if (!values.length) continue;
        const text = shown.kind === 'band' ? `${told(Math.min(...values))} \u2026 ${told(Math.max(...values))}` : told(values[0]);
        lines.push(`${shown.name}: ${withUnit(text, spec.y.unit)}`);
      }
    }
    return lines.length > 1 ? { lines, at, point } : null;
  }

  // ---- zoom: what is drawn is moved, the ticks are made anew

  function redraw(panel) {
    const { left, top, width, height, whole, view } = panel;
    const mx = p => left + (whole.x[0] + (p - left) / width * (whole.x[1] - whole.x[0]) - view.x[0]) / (view.x[1] - view.x[0]) * width;
    const my = p => top + height - (whole.y[0] + (top + height - p) / height * (whole.y[1] - whole.y[0]) - view.y[0]) / (view.y[1] - view.y[0]) * height;
    const zoomed = [0, 1].some(k => view.x[k] !== whole.x[k] || view.y[k] !== whole.y[k]);
    const keep = (node, name) => (node.dataset[name] ??= node.getAttribute(name));
    const path = (node, dx, dy) => {
      let first = true;
      const parts = numbersOf(keep(node, 'd')).map(part => {
        if (/[A-Za-z]/.test(part)) return part;
        const moved = first ? mx(Number(part) + dx) - dx : my(Number(part) + dy) - dy;
        first = !first;
        return moved.toFixed(3);
      });
      node.setAttribute('d', parts.join(' '));
    };
    for (const node of panel.group.querySelectorAll('[clip-path], [clip-path] *')) {
      if (node.closest('.told')) continue;
      if (node.closest('[id^="matplotlib.axis"]')) continue;  // grid lines
      if (node.tagName === 'path' && !node.closest('defs')) path(node, 0, 0);
      else if (node.tagName === 'use') {
        const shape = panel.group.querySelector(`defs > path[id="${node.getAttribute('xlink:href').slice(1)}"]`);
        const x = Number(keep(node, 'x')), y = Number(keep(node, 'y'));
        if (shape && x === 0 && y > panel.top + panel.height) path(shape, x, y);  // a band, in place; else a marker
        else { node.setAttribute('x', mx(x)); node.setAttribute('y', my(y)); }
      } else if (node.tagName === 'image') {
        keep(node, 'transform');
        const sx = (whole.x[1] - whole.x[0]) / (view.x[1] - view.x[0]), sy = (whole.y[1] - whole.y[0]) / (view.y[1] - view.y[0]);
        node.setAttribute('transform', `matrix(${sx} 0 0 ${sy} ${mx(0)} ${my(0)}) ${node.dataset.transform ?? ''}`);
      }
    }
    for (const node of panel.group.querySelectorAll('[id^="xtick_"], [id^="ytick_"]')) node.style.display = zoomed ? 'none' : '';
    for (const id of panel.spec.notes) panel.group.querySelector(`[id="${id}"]`).style.display = zoomed ? 'none' : '';
    panel.ticks?.remove();
    if (zoomed) panel.ticks = drawTicks(panel);
  }
  function drawTicks(panel) {
    const { left, top, width, height, view, spec, sx, sy } = panel, group = make('g', { class: 'told' });
    const labelled = axis => [...panel.group.querySelectorAll(`[id^="${axis}tick_"] text`)][0];
    const low = [sx.from(view.x[0]), sy.from(view.y[0])], high = [sx.from(view.x[1]), sy.from(view.y[1])];
    const text = (x, y, value, like, anchor) => {
      if (!like) return;
      const label = make('text', { x, y, style: like.getAttribute('style'), 'text-anchor': anchor });
      label.style.textAnchor = anchor;
      label.textContent = told(value);
      group.append(label);
    };
    const [xText, yText] = [labelled('x'), labelled('y')];
    for (const value of ticks(spec.x, low[0], high[0], Math.max(2, Math.round(width / 60)))) {
      group.append(make('path', { d: `M ${panel.px(value)} ${top} V ${top + height}`, stroke: GRID, 'stroke-width': 0.6 }));
      text(panel.px(value), top + height + 12, value, xText, 'middle');
    }
    for (const value of ticks(spec.y, Math.min(low[1], high[1]), Math.max(low[1], high[1]), Math.max(2, Math.round(height / 28)))) {
      group.append(make('path', { d: `M ${left} ${panel.py(value)} H ${left + width}`, stroke: GRID, 'stroke-width': 0.6 }));
      text(left - 5, panel.py(value) + 3, value, yText, 'end');
    }
    panel.group.children[0].after(group);  // above the background, below the data
    return group;
  }

  // ---- a figure

  function make(tag, attributes) {
    const node = document.createElementNS(NS, tag);
    for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
    return node;
  }
  function figureOf(svg) {
    const panels = JSON.parse(svg.dataset.panels).map(spec => panelOf(svg, spec)).filter(panel => panel.group);
    const holder = svg.closest('figure'), zoomable = panels.filter(panel => !panel.spec.cells);
    const box = document.createElement('div'), bar = document.createElement('div'), reset = document.createElement('button');
    box.className = 'values'; box.setAttribute('role', 'status'); box.hidden = true;
    bar.className = 'hint';
    bar.append(zoomable.length ? 'Point to read values; drag to zoom.' : 'Point to read values.');
    reset.type = 'button'; reset.textContent = 'Whole figure'; reset.hidden = true;
    bar.append(reset); holder.append(box, bar);
    svg.setAttribute('tabindex', '0');
    const overlay = make('g', { class: 'told', 'pointer-events': 'none' });
    svg.append(overlay);
    let start = null, current = null;

    function place(event) {
      const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
      return [point.x, point.y];
    }
    const panelAt = (x, y) => panels.find(panel => panel.contains(x, y));
    function clear() { overlay.replaceChildren(); box.hidden = true; }
    function show(panel, x, y) {
      clear();
      const found = tell(panel, x, y);
      if (!found) return;
      current = { panel, x, y };
      if (found.at !== undefined)
        for (const other of panels.filter(p => p.spec.shared === panel.spec.shared)) {
          const p = other.px(found.at);
          if (p >= other.left && p <= other.left + other.width)
            overlay.append(make('path', { d: `M ${p} ${other.top} v ${other.height}`, stroke: INK, 'stroke-width': 0.6, 'stroke-dasharray': '3 2' }));
        }
      if (found.point)
        overlay.append(make('circle', { cx: panel.px(found.point.x), cy: panel.py(found.point.y), r: 4.5, fill: 'none', stroke: INK }));
      box.replaceChildren(...found.lines.map(text => Object.assign(document.createElement('div'), { textContent: text })));
      box.hidden = false;
      const frame = holder.getBoundingClientRect(), matrix = svg.getScreenCTM();
      const tip = new DOMPoint(found.at === undefined && !found.point ? x : panel.px(found.point ? found.point.x : found.at), y).matrixTransform(matrix);
      const right = tip.x - frame.left + 14;
      box.style.left = `${right + box.offsetWidth > frame.width ? Math.max(0, tip.x - frame.left - 14 - box.offsetWidth) : right}px`;
      box.style.top = `${Math.max(0, tip.y - frame.top - box.offsetHeight / 2)}px`;
    }
    function zoom(panel, x, y) {  // each a range of the even coordinate, or nothing
      if (x) for (const other of zoomable.filter(p => p.spec.shared === panel.spec.shared)) { other.view.x = x; redraw(other); }
      if (y) { panel.view.y = y; redraw(panel); }
      reset.hidden = !zoomable.some(p => p.view.x[0] !== p.whole.x[0] || p.view.x[1] !== p.whole.x[1] || p.view.y[0] !== p.whole.y[0] || p.view.y[1] !== p.whole.y[1]);
    }
    function unzoom() { clear(); current = null; for (const panel of zoomable) { panel.view.x = [...panel.whole.x]; panel.view.y = [...panel.whole.y]; redraw(panel); } reset.hidden = true; }

    svg.addEventListener('pointerdown', event => {
      const [x, y] = place(event), panel = panelAt(x, y);
      if (event.pointerType !== 'touch' && event.button === 0 && panel && !panel.spec.cells) { start = { panel, x, y }; event.preventDefault(); svg.focus({ preventScroll: true }); }
    });
    svg.addEventListener('pointermove', event => {
      const [x, y] = place(event);
      if (!start) { const panel = panelAt(x, y); if (panel) show(panel, x, y); else clear(); return; }
      const area = dragged(x, y);
      clear();
      if (area) overlay.append(make('rect', { x: area.x, y: area.y, width: area.width, height: area.height, fill: INK, 'fill-opacity': 0.12 }));
    });
    // A drag along one axis zooms that axis, a drag across zooms both.
    function dragged(x, y) {
      const { panel } = start, inX = Math.min(Math.max(x, panel.left), panel.left + panel.width), inY = Math.min(Math.max(y, panel.top), panel.top + panel.height);
      const dx = Math.abs(inX - start.x), dy = Math.abs(inY - start.y);
      if (Math.max(dx, dy) < LEAST_DRAG) return null;
      const alongX = dy < Math.max(LEAST_DRAG, dx / 4), alongY = dx < Math.max(LEAST_DRAG, dy / 4);
      return {
        x: alongY ? panel.left : Math.min(inX, start.x), width: alongY ? panel.width : dx, alongX, alongY,
        y: alongX ? panel.top : Math.min(inY, start.y), height: alongX ? panel.height : dy,
      };
    }
    addEventListener('pointerup', event => {
      if (!start) return;
      const area = dragged(...place(event)), { panel } = start;
      start = null; clear();
      if (!area) return;
      const { sx, sy } = panel, y = [panel.yOf(area.y + area.height), panel.yOf(area.y)].map(sy.to);
      zoom(panel, area.alongY ? null : [panel.xOf(area.x), panel.xOf(area.x + area.width)].map(sx.to), area.alongX ? null : y);
    });
    svg.addEventListener('pointerleave', () => { if (!start) clear(); });
    svg.addEventListener('dblclick', unzoom);
    svg.addEventListener('blur', clear);
    reset.addEventListener('click', unzoom);
    svg.addEventListener('keydown', event => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key], turn = { ArrowDown: 1, ArrowUp: -1 }[event.key];
      if (event.key === 'Escape') unzoom();
      if (step === undefined && turn === undefined) return;
      event.preventDefault();
      let panel = current ? current.panel : panels[0];
      if (turn) panel = panels[(panels.indexOf(panel) + turn + panels.length) % panels.length];
      const from = current ? current.x : panel.left, stops = stopsOf(panel);
      const next = turn ? from : step > 0 ? stops.find(p => p > from + 0.5) : stops.findLast(p => p < from - 0.5);
      if (next !== undefined) show(panel, Math.min(Math.max(next, panel.left), panel.left + panel.width), panel.top + panel.height / 2);
    });
    function stopsOf(panel) {
      const { cells, series } = panel.spec;
      if (cells) return cells.columns.map((_, k) => panel.left + (k + 0.5) / cells.columns.length * panel.width);
      const points = series.filter(s => s.kind === 'points').flatMap(s => s.x.filter(v => v !== null)).map(v => panel.px(v));
      const found = points.length ? points : Array.from({ length: 41 }, (_, k) => panel.left + k / 40 * panel.width);
      return found.filter(p => p >= panel.left && p <= panel.left + panel.width).sort((a, b) => a - b);
    }
  }
  for (const svg of document.querySelectorAll('svg[data-panels]')) figureOf(svg);

  // ---- modes, which move: a button for all of a section

  const moving = [...document.querySelectorAll('svg')].filter(svg => svg.querySelector('animate'));
  const still = matchMedia('(prefers-reduced-motion: reduce)').matches;
  for (const section of still ? [] : new Set(moving.map(svg => svg.closest('section')))) {
    const bar = document.createElement('div'), button = document.createElement('button');
    bar.className = 'hint motion';
    button.textContent = 'Stop the motion';
    let stopped = false;
    button.addEventListener('click', () => {
      stopped = !stopped;
      for (const svg of section.querySelectorAll('svg')) stopped ? svg.pauseAnimations() : svg.unpauseAnimations();
      button.textContent = stopped ? 'Let them move' : 'Stop the motion';
    });
    bar.append(button);
    section.querySelector('.pictures').before(bar);
  }
})();
