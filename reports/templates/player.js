"use strict";
(() => {
  const KINDS = { f4: Float32Array, f8: Float64Array, u2: Uint16Array, u4: Uint32Array };
  const unpack = ({ kind, bytes }) =>
    new KINDS[kind](Uint8Array.from(atob(bytes), (letter) => letter.charCodeAt(0)).buffer);
  const VIEWS = { corner: [0.6, -0.71, 0.37], front: [1, 0, 0], side: [0, -1, 0], above: [0, -1e-3, 1] };
  const CELLS = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5];
  const UP = new THREE.Vector3(0, 1, 0), Z = new THREE.Vector3(0, 0, 1);

  const put = (object, [x, y, z, ...turn]) => {
    object.position.set(x, y, z);
    object.quaternion.set(...turn);
    return object;
  };

  // A motion between its frames: cubic by q and q̇; shares of limits are linear.
  const motionOf = (packed, nv) => {
    const frames = Object.fromEntries(Object.entries(packed).map(([name, x]) => [name, unpack(x)]));
    const { t, q, dq, shares } = frames, last = t.length - 1;
    const at = (time) => {
      let low = 0, high = last;
      while (high - low > 1) {
        const middle = (low + high) >> 1;
        if (t[middle] <= time) low = middle;
        else high = middle;
      }
      const h = t[high] - t[low], s = h > 0 ? (time - t[low]) / h : 0;
      return { low, high, h, s, nearest: s < 0.5 ? low : high };
    };
    const position = ({ low, high, h, s }, j) => {
      const a = low * nv + j, b = high * nv + j, rise = s * s * (3 - 2 * s);
      return (1 - rise) * q[a] + rise * q[b] + h * s * (1 - s) * ((1 - s) * dq[a] - s * dq[b]);
    };
    const share = ({ low, high, s }, k, j) => {
      const [a, b] = [low, high].map((frame) => shares[(frame * (shares.length / t.length / nv) + k) * nv + j]);
      return s === 0 ? a : s === 1 ? b : a + s * (b - a);
    };
    return { ...frames, start: t[0], end: t[last], at, position, share };
  };

  // The joints as nested groups, each with the shapes that it carries.
  const armOf = (data) => {
    const base = new THREE.Group(), paints = [], carriers = [base], joints = [];
    const paint = () => paints.push(new THREE.MeshLambertMaterial());
    paint();
    for (const { parent, place } of data.joints) {
      const fixed = put(new THREE.Group(), place), moving = new THREE.Group();
      carriers[parent].add(fixed);
      fixed.add(moving);
      carriers.push(moving);
      joints.push(moving);
      paint();
    }
    for (const shape of data.shapes)
      carriers[shape.joint].add(put(new THREE.Mesh(solidOf(shape), paints[shape.joint]), shape.place));
    const tool = put(new THREE.Group(), data.tool.place);
    carriers[data.tool.joint].add(tool);
    const axes = data.joints.map(({ axis }) => new THREE.Vector3(...axis));
    const pose = (positions) => {
      positions.forEach((q, j) => {
        if (data.joints[j].slides) joints[j].position.copy(axes[j]).multiplyScalar(q);
        else joints[j].quaternion.setFromAxisAngle(axes[j], q);
      });
      base.updateMatrixWorld();
    };
    return { base, paints, joints, tool, pose };
  };

  const solidOf = ({ kind, size, points, faces }) => {
    const [a, b, c] = size;
    if (kind === "box") return new THREE.BoxGeometry(a, b, c);
    if (kind === "sphere") return new THREE.SphereGeometry(a, 32, 16);
    if (kind === "cylinder") return new THREE.CylinderGeometry(a, a, b, 64).rotateX(Math.PI / 2);
    if (kind === "capsule") return new THREE.CapsuleGeometry(a, b, 8, 32).rotateX(Math.PI / 2);
    const mesh = new THREE.BufferGeometry();
    if (!points) return mesh;
    mesh.setAttribute("position", new THREE.BufferAttribute(unpack(points), 3));
    mesh.setIndex(new THREE.BufferAttribute(unpack(faces), 1));
    const facets = mesh.toNonIndexed();
    facets.computeVertexNormals();
    return facets;
  };

  const obstacleOf = (obstacle, colour, centre, reach) => {
    const { shape, position, rpy, size, radius, low, high, normal, offset } = obstacle;
    if (shape === "half_space") {
      const up = new THREE.Vector3(...normal), away = up.dot(centre) - offset;
      const length = up.length();
      const cell = CELLS.find((each) => 4 * reach < 32 * each) || 10;
      const grid = new THREE.GridHelper(2 * cell * Math.ceil(2 * reach / cell), 2 * Math.ceil(2 * reach / cell));
      const floor = obstacle.name === "floor";
      Object.assign(grid.material, { vertexColors: false, transparent: true, opacity: floor ? 1 : 0.35 });
      up.divideScalar(length);
      grid.quaternion.setFromUnitVectors(UP, up);
      grid.position.copy(centre).addScaledVector(up, -away / length);
      grid.userData = { cell, floor };
      return grid;
    }
    const inside = shape === "workspace", edges = new THREE.LineBasicMaterial({ color: colour });
    const sides = inside ? high.map((x, k) => x - low[k]) : size;
    const solid = shape === "sphere" ? new THREE.SphereGeometry(radius, 32, 16) : new THREE.BoxGeometry(...sides);
    const group = new THREE.Group();
    if (!inside) group.add(new THREE.Mesh(solid, new THREE.MeshLambertMaterial(
      { color: colour, transparent: true, opacity: 0.35, depthWrite: false })));
    if (shape !== "sphere") group.add(new THREE.LineSegments(new THREE.EdgesGeometry(solid), edges));
    group.position.set(...(inside ? high.map((x, k) => (x + low[k]) / 2) : position));
    if (rpy) group.rotation.set(...rpy, "ZYX");
    return group;
  };

  const start = (figure) => {
    const find = (selector) => figure.querySelector(selector);
    const data = JSON.parse(find("script").textContent), nv = data.joints.length;
    const motion = motionOf(data.frames, nv), arm = armOf(data), view = find(".view");
    const rows = [...figure.querySelectorAll("tbody tr")];
    const slider = find("input"), button = find(".play"), clock = find("output"), said = find(".said");
    const numbers = [...Array(nv).keys()], quantities = [...Array(rows[0].cells.length - 2).keys()];
    const limited = quantities.map((k) => numbers.map((j) =>
      motion.shares.some((x, n) => x > 0 && n % (quantities.length * nv) === k * nv + j)));
    const poseAt = (time) => {
      const where = motion.at(time);
      arm.pose(numbers.map((j) => motion.position(where, j)));
      return where;
    };

    const placeOf = (object) => object.getWorldPosition(new THREE.Vector3());
    const path = [], places = [placeOf(arm.base)];
    motion.t.forEach((time, n) => {
      poseAt(time);
      path.push(placeOf(arm.tool));
      if (n % 10 === 0) places.push(...arm.joints.map(placeOf));
    });
    places.push(...path);
    const centre = new THREE.Box3().setFromPoints(places).getCenter(new THREE.Vector3());
    const reach = 1.2 * places.reduce((most, place) => Math.max(most, place.distanceTo(centre)), 0) || 1;

    const scene = new THREE.Scene(), camera = new THREE.PerspectiveCamera(35, 1, reach / 50, 60 * reach);
    camera.up.copy(Z);
    const inks = getComputedStyle(figure), shade = (name) => inks.getPropertyValue(`--${name}`).trim();
    const sun = new THREE.DirectionalLight(0xffffff, 1.9);
    sun.position.set(-0.4, 0.7, 1);
    camera.add(sun, sun.target);
    sun.target.position.set(0, 0, -1);
    const trail = path.filter((place, n) => !n || place.distanceTo(path[n - 1]) > 1e-5 * reach);
    const trace = trail.length < 2 ? new THREE.Group() : new THREE.Mesh(
      new THREE.TubeGeometry(new THREE.CatmullRomCurve3(trail), Math.min(4 * trail.length, 4000), 0.004 * reach, 5),
      new THREE.MeshBasicMaterial());
    const gap = new THREE.Mesh(new THREE.CylinderGeometry(0.008 * reach, 0.008 * reach, 1, 12),
      new THREE.MeshBasicMaterial({ color: shade("green"), depthTest: false, transparent: true }));
    gap.visible = Boolean(motion.points);
    const around = data.obstacles.map((each) => obstacleOf(each, shade("purple"), centre, reach));
    const light = new THREE.HemisphereLight(0xffffff, 0x8d8d8d, 1.6);
    const frame = new THREE.AxesHelper(0.2 * reach).setColors(0xd0021b, 0x2e8b2e, 0x2f5fd0);
    scene.add(arm.base, trace, gap, camera, light, frame, ...around);

    let renderer = null, queued = false, time = motion.start, playing = false, before = 0, levels = [];
    const draw = () => {
      if (queued || !renderer) return;
      queued = true;
      requestAnimationFrame(() => {
        queued = false;
        renderer.render(scene, camera);
      });
    };
    const colour = () => {
      trace.material?.color.set(shade("fitted"));
      arm.paints.forEach((paint, k) => {
        const level = levels[k - 1];
        paint.color.set(level ? shade({ limit: "amber", beyond: "given" }[level]) : shade(k ? `arm-${k % 2}` : "arm-base"));
      });
      for (const each of around)
        if (each.userData.cell) each.material.color.set(each.userData.floor ? shade("grid") : shade("purple"));
    };

    const write = (where) => {
      const told = [];
      levels = numbers.map((j) => {
        const shares = quantities.map((k) => motion.share(where, k, j));
        const most = Math.max(...shares), row = rows[j];
        const level = most > 1 / data.share ? "beyond" : most >= data.touched ? "limit" : "";
        row.dataset.level = level;
        row.cells[1].textContent = `${motion.position(where, j).toFixed(3).replace("-", "−")} ${row.dataset.unit}`;
        quantities.forEach((k) => {
          const cell = row.cells[k + 2], at = shares[k] >= data.touched;
          cell.textContent = limited[k][j] ? `${at ? (shares[k] > 1 / data.share ? "○ " : "◐ ") : ""}${(100 * data.share * shares[k]).toFixed(1)} %` : "–";
          cell.classList.toggle("poor", shares[k] > 1 / data.share);
          cell.classList.toggle("fair", at && shares[k] <= 1 / data.share);
          if (at) told.push(`${row.cells[0].textContent} at ${cell.textContent.slice(2)} of its ${cell.dataset.quantity} limit`);
        });
        return level;
      });
      if (motion.points) {
        const n = where.nearest, [a, b] = [0, 3].map((k) => new THREE.Vector3().fromArray(motion.points, 6 * n + k));
        const length = a.distanceTo(b), inside = motion.distance[n] < 0;
        gap.position.copy(a).add(b).divideScalar(2);
        gap.scale.y = Math.max(length, 1e-4 * reach);
        gap.quaternion.setFromUnitVectors(UP, b.sub(a).divideScalar(length || 1));
        gap.material.color.set(shade(inside ? "given" : "green"));
        const bodies = data.bodies[motion.pair[n]].join(" and ");
        const size = `${Number((1000 * Math.abs(motion.distance[n])).toPrecision(3))} mm`;
        told.push(inside ? `${bodies} overlap by ${size}` : `Nearest: ${bodies}, ${size} apart`);
      }
      said.textContent = told.length ? `${told.join(". ")}.` : quantities.length ? "No limit is touched here." : "";
    };

    const seek = (wanted) => {
      time = Math.min(Math.max(wanted, motion.start), motion.end);
      const where = poseAt(time);
      write(where);
      colour();
      slider.value = time;
      clock.textContent = `${time.toFixed(2)} s`;
      slider.setAttribute("aria-valuetext", `${clock.textContent} of ${motion.end.toFixed(2)} s`);
      draw();
    };
    const tick = (now) => {
      if (!playing) return;
      seek(time + Number(find("[name=speed]").value) * Math.min((now - before) / 1000, 0.1));
      before = now;
      if (time < motion.end) requestAnimationFrame(tick);
      else play(false);
    };
    const play = (on = true) => {
      if (on && time >= motion.end) seek(motion.start);
      playing = on;
      before = performance.now();
      button.textContent = on ? "❚❚ Pause" : "▶ Play";
      if (on) requestAnimationFrame(tick);
    };

    [slider.min, slider.max, slider.step] = [motion.start, motion.end, "any"];
    slider.addEventListener("input", () => {
      play(false);
      seek(slider.valueAsNumber);
    });
    slider.addEventListener("keydown", (event) => {
      const steps = { ArrowLeft: -0.02, ArrowDown: -0.02, ArrowRight: 0.02, ArrowUp: 0.02, PageDown: -1, PageUp: 1 };
      if (!(event.key in steps)) return;
      event.preventDefault();
      play(false);
      seek(time + steps[event.key]);
    });
    button.addEventListener("click", () => play(!playing));
    for (const item of figure.querySelectorAll("[data-t]")) {
      const jump = document.createElement("button");
      jump.type = "button";
      jump.append(...item.childNodes);
      jump.addEventListener("click", () => {
        play(false);
        seek(Number(item.dataset.t));
      });
      item.append(jump);
    }

    const look = () => {
      const { clientWidth, clientHeight } = view, half = Math.tan((camera.fov * Math.PI) / 360);
      const away = reach / Math.sin(Math.atan(half * Math.min(1, clientWidth / clientHeight || 1)));
      const from = new THREE.Vector3(...VIEWS[find("[name=view]").value]).setLength(away);
      camera.position.copy(centre).add(from);
      camera.lookAt(centre);
    };
    const show = () => {
      renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true });
      renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
      const canvas = renderer.domElement, controls = new THREE.OrbitControls(camera, canvas);
      canvas.tabIndex = 0;
      canvas.setAttribute("role", "img");
      canvas.setAttribute("aria-label", "The arm in 3D. Arrow keys move it, with Shift they turn it; the space bar plays.");
      view.replaceChildren(canvas);
      controls.listenToKeyEvents(canvas);
      controls.target.copy(centre);
      controls.enableZoom = false;
      controls.addEventListener("change", draw);
      canvas.addEventListener("focus", () => (controls.enableZoom = true));
      canvas.addEventListener("blur", () => (controls.enableZoom = false));
      canvas.addEventListener("keydown", (event) => {
        if (event.key !== " ") return;
        event.preventDefault();
        play(!playing);
      });
      find("[name=view]").addEventListener("change", () => {
        controls.target.copy(centre);
        look();
        controls.update();
        draw();
      });
      const grid = around.find((each) => each.userData.floor);
      if (grid) view.dataset.scale = `grid ${grid.userData.cell} m`;
      new ResizeObserver(() => {
        const { clientWidth, clientHeight } = view;
        camera.aspect = clientWidth / clientHeight;
        camera.updateProjectionMatrix();
        renderer.setSize(clientWidth, clientHeight, false);
        renderer.render(scene, camera);
      }).observe(view);
      look();
      controls.update();
    };
    try {
      show();
    } catch {
      view.textContent = "This browser draws nothing in 3D (WebGL is off); what is said below still holds.";
      view.classList.add("none");
    }
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      colour();
      draw();
    });
    seek(motion.start);
    const placements = () => arm.joints.map((joint) => [...joint.matrixWorld.elements]);
    figure.player = { seek, play, placements, time: () => time, levels: () => levels };
  };

  const seen = new IntersectionObserver((entries) => entries.forEach(({ isIntersecting, target }) => {
    if (!isIntersecting) return;
    seen.unobserve(target);
    start(target);
  }), { rootMargin: "50% 0px" });
  for (const figure of document.querySelectorAll(".player")) {
    figure.classList.add("live");
    seen.observe(figure);
  }
})();
