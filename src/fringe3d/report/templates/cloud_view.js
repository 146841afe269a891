"use strict";
// A cloud on a canvas: drag turns, shift or right button moves, the wheel zooms, double click resets.
function showCloud(root, cloud) {
  const canvas = root.querySelector("canvas");
  const options = {antialias: true, preserveDrawingBuffer: true};
  const gl = canvas.getContext("webgl", options);
  if (!gl) {
    root.querySelector(".note").textContent = "This browser shows no WebGL; see the pictures below.";
    return;
  }
  const bytes = text => Uint8Array.from(atob(text), letter => letter.charCodeAt(0));
  const program = gl.createProgram();
  const shaders = [[gl.VERTEX_SHADER,
    `attribute vec3 position; attribute float value; uniform mat4 view; uniform float size;
     varying float level;
     void main() { gl_Position = view * vec4(position, 1.0); gl_PointSize = size; level = value; }`],
    [gl.FRAGMENT_SHADER,
    `precision mediump float; varying float level; uniform sampler2D colours;
     void main() { gl_FragColor = texture2D(colours, vec2((level * 255.0 + 0.5) / 256.0, 0.5)); }`]];
  for (const [kind, source] of shaders) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  gl.useProgram(program);
  const buffers = {};
  const attribute = (name, data, n, type) => {
    buffers[name] = buffers[name] || gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers[name]);
    gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
    const place = gl.getAttribLocation(program, name);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, n, type, true, 0, 0);
  };
  attribute("position", new Uint16Array(bytes(cloud.positions).buffer), 3, gl.UNSIGNED_SHORT);
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER])
    gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
  for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T])
    gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);

  const times = (a, b) => a.map(row => b[0].map((_, j) => row.reduce((s, v, k) => s + v * b[k][j], 0)));
  // Strays far away do not set the scale: most points lie in the box that is framed.
  const reach = Math.hypot(...cloud.framed_mm) / 2, whole = Math.hypot(...cloud.size_mm);
  const start = () => ({turn: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], away: 2 * reach, x: 0, y: 0});
  let state = start();

  // Points come in random order: while the view moves only the first ones are drawn, larger, so many
  // that a frame takes 30 to 70 ms. Once it rests for 300 ms the picture fills with all of them, a part
  // in each frame, so that a movement never has to wait for long.
  const least = Math.min(cloud.count, 4096), slow = 70, fast = 30, rest = 300;
  let moving = Math.min(cloud.count, 16384), touched = -Infinity, last = 0, frames = 0, next = null;

  function move() {
    const isMoving = performance.now() - touched < rest;
    touched = performance.now();
    if (isMoving) return;
    frames = 0;
    cancelAnimationFrame(next);
    next = requestAnimationFrame(step);
  }

  function step(now) {
    if (now - touched >= rest) return draw();
    part(0, moving, moving);
    const gap = now - last;
    last = now;
    frames += 1;
    // The first frames still wait for those before.
    if (frames > 2 && (gap > slow || gap < fast)) {
      const wanted = moving * Math.min(2, Math.max(0.1, 45 / gap));
      const changed = Math.round(Math.min(cloud.count, Math.max(least, wanted)));
      if (changed !== moving) frames = 0;
      moving = changed;
    }
    next = requestAnimationFrame(step);
  }

  function draw() {
    cancelAnimationFrame(next);
    touched = -Infinity;
    fill(0);
  }

  function fill(first) {
    const size = Math.max(4 * least, 2 * moving);
    part(first, Math.min(size, cloud.count - first), cloud.count);
    if (first + size < cloud.count) next = requestAnimationFrame(() => fill(first + size));
    else root.dataset.drawn = cloud.count;
  }

  function part(first, count, of) {
    const scale = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth * scale, canvas.clientHeight * scale].map(Math.round);
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    gl.viewport(0, 0, width, height);
    gl.clearColor(0.063, 0.071, 0.086, 1);
    gl.enable(gl.DEPTH_TEST);
    if (first === 0) gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    // Device frame: x right, y down, z forward.
    const turned = times(state.turn, cloud.rotation);
    const near = state.away / 50, far = state.away + 2 * whole, f = 2.2;
    const rows = turned.map((row, i) => {
      const shift = row.reduce((s, v, k) => s - v * cloud.middle_mm[k], 0);
      return [...row.map((v, k) => v * cloud.size_mm[k]), shift + [state.x, state.y, state.away][i]];
    });
    const depth = (far + near) / (far - near), offset = -2 * far * near / (far - near);
    const view = [rows[0].map(v => v * f * height / width), rows[1].map(v => -v * f),
                  rows[2].map((v, k) => v * depth + (k === 3 ? offset : 0)), rows[2]];
    gl.uniformMatrix4fv(gl.getUniformLocation(program, "view"), false,
                        new Float32Array([0, 1, 2, 3].flatMap(j => view.map(row => row[j]))));
    const size = Number(root.querySelector("input").value) * scale * 2 * reach / state.away;
    const larger = Math.sqrt(cloud.count / of);
    gl.uniform1f(gl.getUniformLocation(program, "size"), Math.max(1, size) * larger);
    gl.drawArrays(gl.POINTS, first, count);
    root.dataset.shown = first + count;
  }

  function colour(channel) {
    attribute("value", bytes(channel.values), 1, gl.UNSIGNED_BYTE);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, 256, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, bytes(channel.colours));
    const table = bytes(channel.colours);
    const stops = [0, 32, 64, 96, 128, 160, 192, 224, 255].map(i => `rgb(${table.slice(3 * i, 3 * i + 3)})`);
    root.querySelector(".bar").style.background = `linear-gradient(to right, ${stops})`;
    for (const [name, value] of [[".low", channel.low], [".high", channel.high]])
      root.querySelector(name).textContent =
        typeof value === "string" ? value : `${Number(value.toPrecision(4))} ${channel.unit}`;
    draw();
  }

  const choice = root.querySelector("select");
  for (const channel of cloud.channels) choice.add(new Option(channel.name));
  choice.onchange = () => colour(cloud.channels[choice.selectedIndex]);
  const slider = root.querySelector("input");
  const [large, middle] = [...cloud.framed_mm].sort((a, b) => b - a);
  const spacing = Math.sqrt(large * middle / cloud.count) * 1.1 * canvas.clientHeight / state.away;
  slider.value = Math.min(8, Math.max(1.5, 2.2 * spacing));
  slider.oninput = draw;
  canvas.oncontextmenu = event => event.preventDefault();
  canvas.onpointerdown = event => canvas.setPointerCapture(event.pointerId);
  canvas.onpointermove = event => {
    if (!event.buttons) return;
    const [dx, dy] = [event.movementX, event.movementY];
    if (event.shiftKey || event.buttons > 1) {
      const step = state.away / (1.1 * canvas.clientHeight);
      state.x += dx * step;
      state.y += dy * step;
    } else {
      const [a, b] = [dx * 0.008, dy * 0.008];
      const about_y = [[Math.cos(a), 0, -Math.sin(a)], [0, 1, 0], [Math.sin(a), 0, Math.cos(a)]];
      const about_x = [[1, 0, 0], [0, Math.cos(b), -Math.sin(b)], [0, Math.sin(b), Math.cos(b)]];
      state.turn = times(about_x, times(about_y, state.turn));
    }
    move();
  };
  canvas.addEventListener("wheel", event => {
    event.preventDefault();
    state.away = Math.min(20 * reach, Math.max(0.1 * reach, state.away * Math.exp(event.deltaY * 0.001)));
    move();
  }, {passive: false});
  canvas.ondblclick = () => { state = start(); draw(); };
  window.addEventListener("resize", draw);
  colour(cloud.channels[0]);
}
