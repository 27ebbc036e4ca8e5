#include "report/replay3d.h"

namespace omentum {
namespace {

constexpr const char* kScript = R"js("use strict";
// 3-D replay of recorded episodes. Data: one JSON element with everything that does not move and one base64 block of
// int16 positions per episode. World frame W, metres, z up.
(function () {
  const root = document.getElementById("replay-data");
  const errors = [];
  window.addEventListener("error", (event) => errors.push(String(event.message)));
  const html = document.documentElement;
  const selftest = location.hash.startsWith("#selftest");
  const force2d = location.hash === "#selftest-2d" || location.hash === "#replay-2d";
  if (!root) {
    if (selftest) html.dataset.selftest = "failed no replay in this report";
    return;
  }
  const scene = JSON.parse(root.textContent);

  function decode(text) {
    const raw = atob(text.replace(/\s+/g, ""));
    const bytes = new Uint8Array(raw.length);
    for (let k = 0; k < raw.length; ++k) bytes[k] = raw.charCodeAt(k);
    return new Int16Array(bytes.buffer);
  }
  // int16 -> metres of one coordinate axis
  const scale = scene.high.map((high, axis) => (high - scene.low[axis]) / 65535);
  function unpack(packed) {
    const out = new Float32Array(packed.length);
    for (let k = 0; k < packed.length; ++k) out[k] = scene.low[k % 3] + (packed[k] + 32768) * scale[k % 3];
    return out;
  }
  const triangles = new Uint16Array(scene.triangles);
  for (const body of scene.bodies) {
    body.positions = unpack(decode(body.data));
    body.normals = normals_of(body.positions, body.triangles);
    body.index = new Uint16Array(body.triangles);
  }
  for (const episode of scene.episodes) {
    episode.positions = unpack(decode(document.getElementById(episode.block).textContent));
    episode.tools = unpack(decode(episode.tool_data));
    if (!episode.cloud_block) continue;
    const points = unpack(decode(document.getElementById(episode.cloud_block).textContent));
    let first = 0;
    episode.clouds = episode.cloud_counts.map((count) => points.subarray(3 * first, 3 * (first += count)));
  }
  const stride = 3 * scene.vertices;

  // ---- geometry -----------------------------------------------------------------------------------------------
  function normals_of(p, tri) {
    const n = new Float32Array(p.length);
    for (let t = 0; t < tri.length; t += 3) {
      const a = 3 * tri[t], b = 3 * tri[t + 1], c = 3 * tri[t + 2];
      const ux = p[b] - p[a], uy = p[b + 1] - p[a + 1], uz = p[b + 2] - p[a + 2];
      const vx = p[c] - p[a], vy = p[c + 1] - p[a + 1], vz = p[c + 2] - p[a + 2];
      const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
      for (const k of [a, b, c]) { n[k] += x; n[k + 1] += y; n[k + 2] += z; }
    }
    for (let k = 0; k < n.length; k += 3) {
      const length = Math.hypot(n[k], n[k + 1], n[k + 2]) || 1;
      n[k] /= length; n[k + 1] /= length; n[k + 2] /= length;
    }
    return n;
  }
  // A small triangle across the line of sight for every point.
  function cloud_mesh(points, eye) {
    const size = 0.0007, count = points.length / 3;
    const positions = new Float32Array(9 * count), normals = new Float32Array(9 * count), index = new Uint16Array(3 * count);
    for (let k = 0; k < count; ++k) {
      const p = points.subarray(3 * k, 3 * k + 3);
      const to = [eye[0] - p[0], eye[1] - p[1], eye[2] - p[2]];
      const far = Math.hypot(to[0], to[1], to[2]) || 1;
      const n = to.map((v) => v / far);
      const flat = Math.hypot(n[0], n[1]) || 1;
      const right = [-n[1] / flat, n[0] / flat, 0];
      const up = [n[1] * right[2] - n[2] * right[1], n[2] * right[0] - n[0] * right[2], n[0] * right[1] - n[1] * right[0]];
      [[-1, -0.6], [1, -0.6], [0, 1.1]].forEach(([u, v], corner) => {
        for (let a = 0; a < 3; ++a) {
          positions[9 * k + 3 * corner + a] = p[a] + size * (u * right[a] + v * up[a]) + 0.0003 * n[a];
          normals[9 * k + 3 * corner + a] = n[a];
        }
        index[3 * k + corner] = 3 * k + corner;
      });
    }
    return { positions, normals, index };
  }
  // Shaft and two jaws above the tip: a lathe of (height, radius) pairs and two prisms.
  function tool_mesh(tip, closed, turn) {
    const p = [], tri = [];
    const rings = [[0.0115, 0.0018], [0.0155, 0.004], [0.2, 0.004]];
    const sides = 14;
    for (const [height, radius] of rings) {
      for (let k = 0; k < sides; ++k) {
        const angle = 2 * Math.PI * k / sides;
        p.push(tip[0] + radius * Math.cos(angle), tip[1] + radius * Math.sin(angle), tip[2] + height);
      }
    }
    for (let r = 0; r + 1 < rings.length; ++r) {
      for (let k = 0; k < sides; ++k) {
        const a = r * sides + k, b = r * sides + (k + 1) % sides;
        tri.push(a, b, b + sides, a, b + sides, a + sides);
      }
    }
    const spread = closed ? 0.0002 : 0.0042;
    const c = Math.cos(scene.roll), s = Math.sin(scene.roll);
    for (const side of [-1, 1]) {
      const first = p.length / 3;
      for (const [height, out, half] of [[0.0005, side * spread, 0.0011], [0.0125, side * 0.0008, 0.002]]) {
        for (const [u, v] of [[-half, 0], [half, 0], [half, side * half], [-half, side * half]]) {
          p.push(tip[0] + c * u - s * (out + v), tip[1] + s * u + c * (out + v), tip[2] + height);
        }
      }
      for (let k = 0; k < 4; ++k) {
        const next = (k + 1) % 4;
        tri.push(first + k, first + next, first + 4 + next, first + k, first + 4 + next, first + 4 + k);
      }
      tri.push(first, first + 1, first + 2, first, first + 2, first + 3);
    }
    if (turn) {                                               // Rz(yaw) Ry(pitch) Rx(roll) about the tip
      const [cr, cp, cy] = [0, 1, 2].map((a) => Math.cos(turn[a])), [sr, sp, sy] = [0, 1, 2].map((a) => Math.sin(turn[a]));
      for (let k = 0; k < p.length; k += 3) {
        const x = p[k] - tip[0], y0 = p[k + 1] - tip[1], z0 = p[k + 2] - tip[2];
        const y = cr * y0 - sr * z0, z1 = sr * y0 + cr * z0, x1 = cp * x + sp * z1, z = cp * z1 - sp * x;
        p[k] = tip[0] + cy * x1 - sy * y; p[k + 1] = tip[1] + sy * x1 + cy * y; p[k + 2] = tip[2] + z;
      }
    }
    const positions = new Float32Array(p);
    return { positions, normals: normals_of(positions, tri), index: new Uint16Array(tri) };
  }

  // ---- camera, shared by the panes ------------------------------------------------------------------------------
  const view = { yaw: scene.yaw, pitch: scene.pitch, distance: scene.distance };
  function camera(aspect) {
    const cp = Math.cos(view.pitch), sp = Math.sin(view.pitch), cy = Math.cos(view.yaw), sy = Math.sin(view.yaw);
    const back = [cp * cy, cp * sy, sp];                      // from the target to the eye
    const right = [-sy, cy, 0];
    const up = [back[1] * right[2] - back[2] * right[1], back[2] * right[0] - back[0] * right[2],
                back[0] * right[1] - back[1] * right[0]];
    const eye = back.map((v, k) => scene.target[k] + view.distance * v);
    const f = 1 / Math.tan(0.5 * 0.6), near = 0.05 * scene.distance, far = 7 * scene.distance;
    const dot = (v) => v[0] * eye[0] + v[1] * eye[1] + v[2] * eye[2];
    const rows = [right, up, back];
    const m = new Float32Array(16);                           // column-major
    const s = [f / aspect, f, (far + near) / (near - far)];
    for (let c = 0; c < 3; ++c) {
      m[4 * c] = s[0] * rows[0][c];
      m[4 * c + 1] = s[1] * rows[1][c];
      m[4 * c + 2] = s[2] * rows[2][c];
      m[4 * c + 3] = -rows[2][c];
    }
    m[12] = -s[0] * dot(right);
    m[13] = -s[1] * dot(up);
    m[14] = -s[2] * dot(back) + 2 * far * near / (near - far);
    m[15] = dot(back);
    return { matrix: m, eye };
  }
  const tints = { board: [0.19, 0.22, 0.25], organ: [0.40, 0.11, 0.10], tumour: [0.22, 0.50, 0.24],
                  tissue: [0.86, 0.62, 0.24], tool: [0.62, 0.65, 0.69], obstacle: [0.34, 0.26, 0.44],
                  cloud: [0.10, 0.45, 0.85] };

  // ---- WebGL ----------------------------------------------------------------------------------------------------
  const vertex_source = `
    attribute vec3 position; attribute vec3 normal;
    uniform mat4 matrix; varying vec3 n; varying vec3 p;
    void main() { n = normal; p = position; gl_Position = matrix * vec4(position, 1.0); }`;
  const fragment_source = `
    precision mediump float;
    varying vec3 n; varying vec3 p;
    uniform vec3 eye; uniform vec3 tint; uniform float checks;
    void main() {
      vec3 to_eye = normalize(eye - p);
      vec3 normal = normalize(n);
      if (dot(normal, to_eye) < 0.0) normal = -normal;
      vec3 side = normalize(vec3(0.45, 0.55, 0.75));
      float light = 0.16 + 0.52 * max((dot(normal, to_eye) + 0.2) / 1.2, 0.0) + 0.5 * max((dot(normal, side) + 0.25) / 1.25, 0.0);
      float shine = pow(max(dot(normal, normalize(to_eye + side)), 0.0), 36.0);
      vec3 base = tint;
      if (checks > 0.0) base *= mix(0.78, 1.1, mod(floor(p.x / 0.01 + 0.5) + floor(p.y / 0.01 + 0.5), 2.0));
      gl_FragColor = vec4(pow(base * light + 0.16 * (1.0 - checks) * shine, vec3(0.4545)), 1.0);
    }`;
  function webgl_painter(canvas) {
    const gl = canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true });
    if (!gl) return null;
    const program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex_source], [gl.FRAGMENT_SHADER, fragment_source]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) return null;
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) return null;
    gl.useProgram(program);
    const place = (name) => gl.getUniformLocation(program, name);
    const uniforms = { matrix: place("matrix"), eye: place("eye"), tint: place("tint"), checks: place("checks") };
    const attributes = ["position", "normal"].map((name) => gl.getAttribLocation(program, name));
    attributes.forEach((a) => gl.enableVertexAttribArray(a));
    const buffers = [gl.createBuffer(), gl.createBuffer(), gl.createBuffer()];
    gl.enable(gl.DEPTH_TEST);
    function fill(mesh, kind) {
      [mesh.positions, mesh.normals].forEach((values, k) => {
        gl.bindBuffer(gl.ARRAY_BUFFER, buffers[k]);
        gl.bufferData(gl.ARRAY_BUFFER, values, gl.STREAM_DRAW);
        gl.vertexAttribPointer(attributes[k], 3, gl.FLOAT, false, 0, 0);
      });
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers[2]);
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, mesh.index, gl.STREAM_DRAW);
      gl.uniform3fv(uniforms.tint, tints[kind]);
      gl.uniform1f(uniforms.checks, kind === "board" ? 1 : 0);
      gl.drawElements(gl.TRIANGLES, mesh.index.length, gl.UNSIGNED_SHORT, 0);
    }
    return {
      name: "webgl",
      paint(meshes, cam) {
        gl.viewport(0, 0, canvas.width, canvas.height);
        gl.clearColor(0.083, 0.094, 0.11, 1);
        gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
        gl.uniformMatrix4fv(uniforms.matrix, false, cam.matrix);
        gl.uniform3fv(uniforms.eye, cam.eye);
        for (const { mesh, kind } of meshes) fill(mesh, kind);
      },
    };
  }

  // ---- 2-D canvas: triangles from far to near --------------------------------------------------------------------
  function canvas_painter(canvas) {
    const context = canvas.getContext("2d");
    return {
      name: "2d",
      paint(meshes, cam) {
        const w = canvas.width, h = canvas.height, m = cam.matrix;
        context.fillStyle = "#15181c";
        context.fillRect(0, 0, w, h);
        const faces = [];
        for (const { mesh, kind } of meshes) {
          const p = mesh.positions, screen = new Float32Array(p.length);
          for (let k = 0; k < p.length; k += 3) {
            const d = m[3] * p[k] + m[7] * p[k + 1] + m[11] * p[k + 2] + m[15];
            screen[k] = w * (0.5 + 0.5 * (m[0] * p[k] + m[4] * p[k + 1] + m[8] * p[k + 2] + m[12]) / d);
            screen[k + 1] = h * (0.5 - 0.5 * (m[1] * p[k] + m[5] * p[k + 1] + m[9] * p[k + 2] + m[13]) / d);
            screen[k + 2] = d;
          }
          for (let t = 0; t < mesh.index.length; t += 3) {
            const a = 3 * mesh.index[t], b = 3 * mesh.index[t + 1], c = 3 * mesh.index[t + 2];
            if (Math.min(screen[a + 2], screen[b + 2], screen[c + 2]) < 0.02) continue;
            const n = mesh.normals, eye = cam.eye;
            let light = 0;
            const ex = eye[0] - p[a], ey = eye[1] - p[a + 1], ez = eye[2] - p[a + 2], el = Math.hypot(ex, ey, ez);
            light = 0.25 + 0.75 * Math.abs(n[a] * ex + n[a + 1] * ey + n[a + 2] * ez) / el;
            const depth = screen[a + 2] + screen[b + 2] + screen[c + 2] + (kind === "board" ? 10 : 0);
            faces.push([depth, screen[a], screen[a + 1], screen[b], screen[b + 1], screen[c], screen[c + 1], kind, light]);
          }
        }
        faces.sort((x, y) => y[0] - x[0]);
        for (const f of faces) {
          const colour = tints[f[7]].map((v) => Math.round(255 * Math.pow(Math.min(1, v * f[8]), 0.4545)));
          context.fillStyle = context.strokeStyle = `rgb(${colour.join(",")})`;
          context.beginPath();
          context.moveTo(f[1], f[2]);
          context.lineTo(f[3], f[4]);
          context.lineTo(f[5], f[6]);
          context.closePath();
          context.fill();
          context.stroke();
        }
      },
    };
  }

  // ---- panes ----------------------------------------------------------------------------------------------------
  const slider = document.getElementById("replay-time");
  const clock = document.getElementById("replay-clock");
  const button = document.getElementById("replay-play");
  const duration = Math.max(...scene.episodes.map((e) => e.times[e.times.length - 1]));
  slider.max = duration;
  slider.step = duration / 2000;
  const panes = Array.from(document.querySelectorAll(".pane")).map((element, number) => {
    const canvas = element.querySelector("canvas");
    const choice = element.querySelector("select");
    scene.episodes.forEach((episode, k) => {
      const option = document.createElement("option");
      option.value = k;
      option.textContent = episode.label;
      choice.appendChild(option);
    });
    choice.value = Math.min(number, scene.episodes.length - 1);
    choice.addEventListener("change", draw);
    const painter = (force2d ? null : webgl_painter(canvas)) || canvas_painter(canvas);
    return { canvas, choice, painter, state: element.querySelector(".state") };
  });
  function frame_at(episode, time) {
    const times = episode.times;
    let k = 0;
    while (k + 1 < times.length && times[k + 1] <= time) ++k;
    const span = k + 1 < times.length ? times[k + 1] - times[k] : 1;
    return { k, share: k + 1 < times.length ? Math.min(1, Math.max(0, (time - times[k]) / span)) : 0 };
  }
  function between(values, width, k, share) {
    const out = new Float32Array(width);
    const a = k * width, b = Math.min(values.length - width, a + width);
    for (let j = 0; j < width; ++j) out[j] = values[a + j] * (1 - share) + values[b + j] * share;
    return out;
  }
  function draw() {
    const time = Number(slider.value);
    clock.textContent = time.toFixed(2) + " s";
    for (const pane of panes) {
      const { canvas, painter } = pane;
      const ratio = Math.min(2, window.devicePixelRatio || 1);
      const w = Math.round((canvas.clientWidth || 480) * ratio), h = Math.round((canvas.clientHeight || 360) * ratio);
      if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
      const episode = scene.episodes[Number(pane.choice.value)];
      const { k, share } = frame_at(episode, time);
      const sheet = { positions: between(episode.positions, stride, k, share), index: triangles };
      sheet.normals = normals_of(sheet.positions, triangles);
      const tip = between(episode.tools, 3, k, share);
      const turn = episode.turns && between(episode.turns, 3, k, share);
      const meshes = scene.bodies.map((body) => ({ mesh: body, kind: body.kind }));
      meshes.push({ mesh: sheet, kind: "tissue" }, { mesh: tool_mesh(tip, episode.held[k], turn), kind: "tool" });
      const cam = camera(w / h);
      if (episode.clouds) {
        const nearest = Math.min(episode.clouds.length - 1, k + (share > 0.5 ? 1 : 0));
        meshes.push({ mesh: cloud_mesh(episode.clouds[nearest], cam.eye), kind: "cloud" });
      }
      painter.paint(meshes, cam);
      pane.state.textContent = episode.notes ? episode.notes[k] : episode.note ?? `exposure ${(100 * episode.exposure[k]).toFixed(0)} %` + (episode.held[k] ? " \u00b7 held" : "");
    }
  }

  // ---- controls -------------------------------------------------------------------------------------------------
  let playing = false, before = 0;
  function tick(now) {
    if (!playing) return;
    const next = Number(slider.value) + (now - before) / 1000 * scene.speed;
    before = now;
    slider.value = next >= duration ? 0 : next;
    draw();
    requestAnimationFrame(tick);
  }
  button.addEventListener("click", () => {
    playing = !playing;
    button.textContent = playing ? "Pause" : "Play";
    if (playing) { before = performance.now(); requestAnimationFrame(tick); }
  });
  slider.addEventListener("input", draw);
  window.addEventListener("resize", draw);
  for (const { canvas } of panes) {
    const fingers = new Map();
    canvas.addEventListener("pointerdown", (event) => {
      fingers.set(event.pointerId, [event.clientX, event.clientY]);
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      const last = fingers.get(event.pointerId);
      if (!last) return;
      const here = [event.clientX, event.clientY];
      if (fingers.size === 1) {
        turn(-0.008 * (here[0] - last[0]), 0.008 * (here[1] - last[1]));
      } else {
        const other = Array.from(fingers).find(([id]) => id !== event.pointerId)[1];
        const gap = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]) || 1;
        zoom(gap(last) / gap(here));
      }
      fingers.set(event.pointerId, here);
      draw();
    });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => fingers.delete(event.pointerId));
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      zoom(Math.exp(0.001 * event.deltaY));
      draw();
    }, { passive: false });
    canvas.addEventListener("dblclick", first_view);
    canvas.addEventListener("keydown", (event) => {
      const step = 0.1;
      const acts = { ArrowLeft: () => turn(step, 0), ArrowRight: () => turn(-step, 0), ArrowUp: () => turn(0, step),
                     ArrowDown: () => turn(0, -step), "+": () => zoom(0.9), "=": () => zoom(0.9), "-": () => zoom(1 / 0.9),
                     "0": first_view };
      if (!acts[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      acts[event.key]();
      draw();
    });
  }
  function turn(yaw, pitch) {
    view.yaw += yaw;
    view.pitch = Math.min(1.5, Math.max(-0.2, view.pitch + pitch));
  }
  function first_view() {
    Object.assign(view, { yaw: scene.yaw, pitch: scene.pitch, distance: scene.distance });
    draw();
  }
  function zoom(factor) {
    view.distance = Math.min(3.3 * scene.distance, Math.max(0.22 * scene.distance, view.distance * factor));
  }
  slider.value = 0.8 * duration;  // something has happened by then
  draw();
  if (scene.live) {
    window.show_frame = (frame) => {
      Object.assign(scene.episodes[0], frame);
      draw();
    };
  }

  // ---- self-test ------------------------------------------------------------------------------------------------
  if (selftest) {
    try {
      const shots = [0, duration].map((time) => {
        slider.value = time;
        slider.dispatchEvent(new Event("input"));
        return panes.map((pane) => pane.canvas.toDataURL());
      });
      const moved = panes.every((pane, k) => shots[0][k] !== shots[1][k]);
      const pictures = () => panes.map((pane) => pane.canvas.toDataURL());
      const press = (key) => panes[0].canvas.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
      const differs = (a, b) => a.every((shot, k) => shot !== b[k]);
      for (let k = 0; k < 5; ++k) press("ArrowLeft");
      const left = pictures();
      press("+");
      const near = pictures();
      press("0");
      const turned = panes.every((pane) => pane.canvas.tabIndex === 0) && differs(left, shots[1]) &&
          differs(near, left) && pictures().every((shot, k) => shot === shots[1][k]);
      const drawn = shots[0].every((shot) => shot.length > 2000);
      html.dataset.selftest = (moved && turned && drawn && errors.length === 0 ? "ok" : "failed") +
          ` painter=${panes.map((pane) => pane.painter.name).join("+")} moved=${moved} turned=${turned} drawn=${drawn}` +
          ` errors=${errors.join("; ")}`;
    } catch (error) {
      html.dataset.selftest = "failed " + error;
    }
  }
})();
)js";

}  // namespace

std::string replay_script() { return kScript; }

}  // namespace omentum
