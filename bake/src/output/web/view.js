// Shows a bake: albedo times E / pi, exposed and tone-mapped as preview.png is. WebGL 2 alone.
// Lengths are metres from the middle of the scene, light is in nits.

const byId = (id) => document.getElementById(id);

function fail(message) {
  byId("message").textContent = message;
  byId("message").hidden = false;
  document.documentElement.dataset.failed = "true";
}

// ---- Data

/** The bytes of a script element: base64 of a zlib stream. */
async function unpack(id) {
  const text = atob(byId(id).textContent);
  byId(id).remove();
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = text.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// ---- WebGL

function program(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  const uniforms = {};
  for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
    const { name } = gl.getActiveUniform(program, i);
    uniforms[name] = gl.getUniformLocation(program, name);
  }
  return { program, ...uniforms };
}

function lightTexture(gl, page, texels) {
  const most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
  if (most < Math.max(page.width, page.height)) {
    throw new Error(`A lightmap has ${page.width} x ${page.height} texels, this device takes ${most}: bake with --max-size ${most}.`);
  }
  const words = new Uint32Array(texels.buffer, page.at, page.width * page.height);
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB9_E5, page.width, page.height, 0, gl.RGB, gl.UNSIGNED_INT_5_9_9_9_REV, words);
  for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
  for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.LINEAR);
  return texture;
}

async function colorTexture(gl, { type, at, length, wrap, nearest }, bytes) {
  const blob = new Blob([bytes.subarray(at, at + length)], { type });
  const asIs = { premultiplyAlpha: "none", colorSpaceConversion: "none" };
  const most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
  let image = await createImageBitmap(blob, asIs);
  const factor = most / Math.max(image.width, image.height);
  if (factor < 1) {
    const [resizeWidth, resizeHeight] = [image.width, image.height].map((n) => Math.max(1, Math.floor(n * factor)));
    image = await createImageBitmap(blob, { ...asIs, resizeWidth, resizeHeight, resizeQuality: "high" });
  }
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.SRGB8_ALPHA8, gl.RGBA, gl.UNSIGNED_BYTE, image);
  gl.generateMipmap(gl.TEXTURE_2D);
  const wraps = { repeat: gl.REPEAT, mirror: gl.MIRRORED_REPEAT, clamp: gl.CLAMP_TO_EDGE };
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, wraps[wrap[0]]);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, wraps[wrap[1]]);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, nearest ? gl.NEAREST_MIPMAP_LINEAR : gl.LINEAR_MIPMAP_LINEAR);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, nearest ? gl.NEAREST : gl.LINEAR);
  const sharp = gl.getExtension("EXT_texture_filter_anisotropic");
  if (sharp && !nearest) gl.texParameterf(gl.TEXTURE_2D, sharp.TEXTURE_MAX_ANISOTROPY_EXT, 8);
  return texture;
}

function white(gl) {
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array([255, 255, 255, 255]));
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  return texture;
}

/** A vertex array of one draw; attributes that it lacks have constants. */
function vertexArray(gl, draw, indices) {
  const array = gl.createVertexArray();
  gl.bindVertexArray(array);
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, indices);
  const attribute = (place, at, size, kind, normalized) => {
    if (at === undefined) return;
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, size, kind, normalized, 0, at);
  };
  attribute(0, draw.position, 3, gl.FLOAT, false);
  attribute(1, draw.light_uv, 2, gl.FLOAT, false);
  attribute(2, draw.base_uv, 2, gl.FLOAT, false);
  attribute(3, draw.glow_uv, 2, gl.FLOAT, false);
  attribute(4, draw.tint, 4, gl.UNSIGNED_SHORT, true);
  attribute(5, draw.pass_uv, 2, gl.FLOAT, false);
  return array;
}

// ---- Camera: where the eye is, angles in radians, and how far ahead is what it turns around

function startPose(scene) {
  const [right, , back, eye] = scene.camera.world_from_camera;
  const unit = (v) => v.slice(0, 3).map((x) => x / (Math.hypot(v[0], v[1], v[2]) || 1));
  const [r, f] = [unit(right), unit(back).map((x) => -x)];
  const upright = Math.abs(f[1]) < 0.9999;
  const yaw = upright ? Math.atan2(-f[0], -f[2]) : Math.atan2(-r[2], r[0]);
  const pose = { eye: eye.slice(0, 3), yaw, pitch: Math.asin(Math.max(-1, Math.min(1, f[1]))), roll: 0, distance: scene.camera.focus, zoom: 1 };
  const level = basis(pose);
  pose.roll = Math.atan2(dot(r, level.up), dot(r, level.right));
  return pose;
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const along = (p, d, t) => p.map((x, i) => x + d[i] * t);

function basis({ yaw, pitch, roll }) {
  const [sy, cy, sp, cp, sr, cr] = [Math.sin(yaw), Math.cos(yaw), Math.sin(pitch), Math.cos(pitch), Math.sin(roll), Math.cos(roll)];
  const forward = [-sy * cp, sp, -cy * cp];
  const side = [cy, 0, -sy];
  const top = [sy * sp, cp, cy * sp];
  return {
    forward,
    right: side.map((x, i) => x * cr + top[i] * sr),
    up: top.map((x, i) => x * cr - side[i] * sr),
  };
}

/** Half width and half height of the picture at distance 1, or in metres for parallel cameras: all that the camera covers. */
function extent({ projection: p }, zoom, aspect) {
  const flat = p.kind === "orthographic";
  const half = flat ? Math.abs(p.ymag) * zoom : Math.tan(p.yfov / 2);
  const wanted = flat ? Math.abs(p.xmag / p.ymag) : p.aspect;
  const height = half * Math.max(1, wanted / aspect);
  return { flat, width: height * aspect, height };
}

function clipFromWorld({ flat, width, height }, pose, { right, up, forward }, radius) {
  const far = Math.hypot(...pose.eye) + 2 * radius;
  // In a room on a wide ground the room counts.
  const near = flat ? -far : Math.min(5e-4 * radius, 0.02 * pose.distance);
  const [zz, zw] = flat ? [-2 / (far - near), -(far + near) / (far - near)] : [-(far + near) / (far - near), (-2 * far * near) / (far - near)];
  const row = (axis, factor) => [...axis.map((x) => x * factor), -dot(axis, pose.eye) * factor];
  const x = row(right, 1 / width);
  const y = row(up, 1 / height);
  const depth = row(forward, -1);
  const z = depth.map((v, i) => v * zz + (i === 3 ? zw : 0));
  const w = flat ? [0, 0, 0, 1] : depth.map((v) => -v);
  return [0, 1, 2, 3].flatMap((i) => [x[i], y[i], z[i], w[i]]);
}

/** Product of column-major matrices. */
function times(a, b) {
  return a.map((_, k) => [0, 1, 2, 3].reduce((sum, j) => sum + a[4 * j + (k % 4)] * b[4 * Math.floor(k / 4) + j], 0));
}

// ---- The page

async function show() {
  const canvas = byId("view");
  const gl = canvas.getContext("webgl2", { alpha: false });
  if (!gl) throw new Error("This browser has no WebGL 2, which the page needs.");
  if (!window.DecompressionStream) throw new Error("This browser cannot unpack the page; one of 2023 or later can.");
  canvas.addEventListener("webglcontextlost", () => fail("The graphics card was lost. Load the page again."));

  const scene = JSON.parse(byId("scene").textContent);
  const [vertices, indices, texels, encoded] = await Promise.all(["vertices", "indices", "texels", "images"].map(unpack));
  const surface = program(gl, SHADERS.surface[0], SHADERS.surface[1]);
  const sky = program(gl, SHADERS.sky[0], SHADERS.sky[1]);
  const none = white(gl);
  const pages = scene.pages.map((page) => lightTexture(gl, page, texels));
  const textures = await Promise.all(scene.textures.map((t) => colorTexture(gl, t, encoded)));
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, vertices, gl.STATIC_DRAW);
  const indexBuffer = gl.createBuffer();
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, indexBuffer);
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, indices, gl.STATIC_DRAW);
  const arrays = scene.draws.map((draw) => vertexArray(gl, draw, indexBuffer));
  gl.vertexAttrib4f(4, 1, 1, 1, 1);

  const start = startPose(scene);
  let pose = { ...start };
  const mode = () => Number(document.querySelector("input[name=mode]:checked").value);

  function drawSurface(draw, array, clip, part) {
    const texture = (unit, value) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, value ?? none);
    };
    texture(0, pages[draw.page]);
    texture(1, textures[draw.base_map]);
    texture(2, textures[draw.glow_map]);
    texture(3, textures[draw.pass_map]);
    gl.uniformMatrix4fv(surface.clip_from_mesh, false, times(clip, draw.world_from_mesh));
    gl.uniform4fv(surface.base, draw.base);
    gl.uniform3fv(surface.glow, draw.glow);
    gl.uniform1i(surface.has_texels, draw.page !== undefined ? 1 : 0);
    gl.uniform1f(surface.light_scale, scene.pages[draw.page]?.scale ?? 0);
    gl.uniform1f(surface.cutoff, draw.cutoff ?? -1);
    gl.uniform1f(surface.through, draw.pass);
    gl.uniform1i(surface.part, part);
    gl.uniform1i(surface.blend, draw.blend ? 1 : 0);
    draw.double_sided ? gl.disable(gl.CULL_FACE) : gl.enable(gl.CULL_FACE);
    gl.bindVertexArray(array);
    gl.drawElements(gl.TRIANGLES, draw.count, draw.wide ? gl.UNSIGNED_INT : gl.UNSIGNED_SHORT, draw.indices);
  }

  function drawSky(view, axes, exposure) {
    const corner = (axis, factor) => axis.map((x) => x * factor);
    const [x, y] = view.flat ? [0, 0] : [view.width, view.height];
    gl.useProgram(sky.program);
    gl.uniformMatrix3fv(sky.world_from_clip, false, [...corner(axes.right, x), ...corner(axes.up, y), ...axes.forward]);
    gl.uniform1f(sky.exposure, exposure);
    for (const part of ["zenith", "horizon", "ground"]) gl.uniform3fv(sky[part], scene.sky[part]);
    gl.disable(gl.CULL_FACE);
    gl.depthMask(false);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.depthMask(true);
  }

  function draw() {
    const scale = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((n) => Math.max(1, Math.round(n * scale)));
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    gl.viewport(0, 0, width, height);
    gl.clearColor(0.06, 0.06, 0.07, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    const axes = basis(pose);
    const view = extent(scene.camera, pose.zoom, width / height);
    const clip = clipFromWorld(view, pose, axes, scene.radius);
    const exposure = scene.exposure * 2 ** byId("exposure").valueAsNumber;
    gl.bindVertexArray(null);
    if (mode() === 0) drawSky(view, axes, exposure);
    gl.useProgram(surface.program);
    gl.uniform1f(surface.exposure, exposure);
    gl.uniform1i(surface.mode, mode());
    gl.uniform3fv(surface.mean_light, scene.mean_light);
    ["light_map", "base_map", "glow_map", "through_map"].forEach((name, unit) => gl.uniform1i(surface[name], unit));
    const layers = [false, true].map((wanted) => scene.draws.map((d, i) => i).filter((i) => (scene.draws[i].blend || 0 < scene.draws[i].pass) === wanted));
    layers[0].forEach((i) => drawSurface(scene.draws[i], arrays[i], clip, 0));
    gl.enable(gl.BLEND);
    gl.depthMask(false);
    for (const i of layers[1]) {
      gl.blendFunc(gl.ZERO, gl.SRC_COLOR);
      drawSurface(scene.draws[i], arrays[i], clip, 1);
      gl.blendFunc(gl.ONE, gl.ONE);
      drawSurface(scene.draws[i], arrays[i], clip, 2);
    }
    gl.disable(gl.BLEND);
    gl.depthMask(true);
    const error = gl.getError();
    if (error !== gl.NO_ERROR && !gl.isContextLost()) throw new Error(`WebGL reports error ${error}.`);
    document.documentElement.dataset.ready = "true";
  }

  // ---- Input

  const moves = ["KeyW", "KeyA", "KeyS", "KeyD", "KeyQ", "KeyE", "ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown"];
  const held = new Set();
  let [waiting, before, fast] = [false, 0, false];
  function frame(now) {
    waiting = false;
    walk(Math.max(0, Math.min(0.1, (now - before) / 1000)));
    before = now;
    draw();
    if (held.size) request();
  }
  function request() {
    if (!waiting) requestAnimationFrame(frame);
    waiting = true;
  }

  function turn(yaw, pitch) {
    pose.yaw += yaw;
    pose.pitch = Math.max(-Math.PI / 2, Math.min(Math.PI / 2, pose.pitch + pitch));
  }
  function orbit(yaw, pitch) {
    const middle = along(pose.eye, basis(pose).forward, pose.distance);
    turn(yaw, pitch);
    pose.eye = along(middle, basis(pose).forward, -pose.distance);
  }
  function shift(x, y) {
    const { right, up } = basis(pose);
    pose.eye = along(along(pose.eye, right, x * pose.distance), up, y * pose.distance);
  }
  function nearer(factor) {
    // What is turned around never gets nearer than a thousandth of the scene, so one can go on.
    const distance = Math.max(Math.min(1e-3 * scene.radius, 0.1 * start.distance), pose.distance * factor);
    pose.eye = along(pose.eye, basis(pose).forward, pose.distance - distance);
    [pose.distance, pose.zoom] = [distance, pose.zoom * factor];
  }
  function walk(seconds) {
    const axis = (plus, minus) => Number(held.has(plus)) - Number(held.has(minus));
    const speed = Math.min(scene.radius, 4 * start.distance) * seconds * (fast ? 1 : 0.25);
    const { right, up, forward } = basis(pose);
    pose.eye = along(pose.eye, forward, axis("KeyW", "KeyS") * speed);
    pose.eye = along(pose.eye, right, axis("KeyD", "KeyA") * speed);
    pose.eye = along(pose.eye, up, axis("KeyE", "KeyQ") * speed);
    turn(axis("ArrowLeft", "ArrowRight") * seconds, axis("ArrowUp", "ArrowDown") * seconds);
  }

  const fingers = new Map();
  canvas.addEventListener("pointerdown", (e) => {
    canvas.setPointerCapture(e.pointerId);
    fingers.set(e.pointerId, [e.clientX, e.clientY]);
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (e) => fingers.delete(e.pointerId));
  canvas.addEventListener("pointermove", (e) => {
    const last = fingers.get(e.pointerId);
    if (!last) return;
    const unit = 2 / canvas.clientHeight;
    const [x, y] = [(e.clientX - last[0]) * unit, (e.clientY - last[1]) * unit];
    const others = [...fingers].filter(([id]) => id !== e.pointerId);
    if (others.length) {
      const apart = (p) => Math.hypot(p[0] - others[0][1][0], p[1] - others[0][1][1]) || 1;
      nearer(apart(last) / apart([e.clientX, e.clientY]));
      shift(-x / 4, y / 4);
    } else if (e.shiftKey) {
      shift(-x / 2, y / 2);
    } else {
      orbit(-1.5 * x, -1.5 * y);
    }
    fingers.set(e.pointerId, [e.clientX, e.clientY]);
    request();
  });
  canvas.addEventListener("wheel", (e) => {
    e.preventDefault();
    nearer(2 ** (Math.sign(e.deltaY) / 4));
    request();
  }, { passive: false });

  const expose = (stops) => {
    byId("exposure").valueAsNumber += stops;
    changed();
  };
  function changed() {
    byId("stops").value = byId("exposure").value;
    request();
  }
  addEventListener("keydown", (e) => {
    fast = e.shiftKey;
    // Arrows and Home belong to the slider and the switch while they have the focus.
    const taken = e.target.matches?.("input") && /^(Arrow|Home)/.test(e.code);
    if (taken || e.ctrlKey || e.metaKey || e.altKey) return;
    if (moves.includes(e.code)) {
      if (!held.size) before = performance.now();
      held.add(e.code);
    } else if (["1", "2", "3"].includes(e.key)) document.querySelector(`input[name=mode][value="${e.key - 1}"]`).checked = true;
    else if (e.key === "+" || e.key === "-") expose(e.key === "+" ? 0.25 : -0.25);
    else if (e.key === "Home") pose = { ...start };
    else return;
    e.preventDefault();
    request();
  });
  addEventListener("keyup", (e) => {
    held.delete(e.code);
    fast = e.shiftKey;
  });
  addEventListener("blur", () => held.clear());
  byId("exposure").addEventListener("input", changed);
  document.querySelectorAll("input[name=mode]").forEach((input) => input.addEventListener("change", request));
  byId("reset").addEventListener("click", () => {
    pose = { ...start };
    request();
  });
  addEventListener("resize", request);
  draw();
}

addEventListener("error", (e) => fail(e.message));
show().catch((e) => fail(e.message));
