// Draws the humanoid and its ground. The camera stays where it is put, and the world is moved below it.
import * as THREE from 'three';
import { OrbitControls } from 'three/addons/controls/OrbitControls.js';

const SKY = '#e9eef3';
const COLOURS = { right: '#e07a3f', left: '#3f7fbf', middle: '#6f7a86' };
const TILE = 2; // two squares of a metre
const ARROW_SHOWN = 0.8; // after a push [s]

function tiles() {
  const canvas = document.createElement('canvas');
  canvas.width = canvas.height = 256;
  const context = canvas.getContext('2d');
  context.fillStyle = '#d5dbe1';
  context.fillRect(0, 0, 256, 256);
  context.fillStyle = '#c3cbd3';
  context.fillRect(0, 0, 128, 128);
  context.fillRect(128, 128, 128, 128);
  const texture = new THREE.CanvasTexture(canvas);
  texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
  texture.colorSpace = THREE.SRGBColorSpace;
  texture.anisotropy = 8;
  return texture;
}

export class Stage {
  constructor(container) {
    this.renderer = new THREE.WebGLRenderer({ antialias: true });
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    container.append(this.renderer.domElement);
    this.container = container;
    this.scene = new THREE.Scene();
    this.scene.background = new THREE.Color(SKY);
    this.scene.fog = new THREE.Fog(SKY, 9, 17);
    this.camera = new THREE.PerspectiveCamera(36, 1, 0.1, 60);
    this.camera.up.set(0, 0, 1);
    this.camera.position.set(1.6, -4.4, 1.5);
    this.controls = new OrbitControls(this.camera, this.renderer.domElement);
    this.controls.target.set(0, 0, 0.8);
    this.controls.maxPolarAngle = 1.55;
    this.controls.minDistance = 1.5;
    this.controls.maxDistance = 9;
    this.controls.enablePan = false;
    this.scene.add(new THREE.HemisphereLight('#ffffff', '#9aa4ad', 1.8));
    const sun = new THREE.DirectionalLight('#fff6e8', 2.2);
    sun.position.set(2.5, -3, 6);
    sun.castShadow = true;
    sun.shadow.mapSize.set(1024, 1024);
    Object.assign(sun.shadow.camera, { left: -2.5, right: 2.5, top: 2.5, bottom: -2.5, near: 1, far: 12 });
    sun.shadow.bias = -0.0005;
    sun.shadow.normalBias = 0.02;
    this.scene.add(sun);
    this.world = new THREE.Group();
    this.scene.add(this.world);
    this.arrow = new THREE.ArrowHelper(new THREE.Vector3(1, 0, 0), new THREE.Vector3(), 0.6, '#d62f4b', 0.2, 0.12);
    this.arrow.visible = false;
    this.focus = [0, 0];
    new ResizeObserver(() => this.fit()).observe(container);
    this.fit();
  }

  fit() {
    const { clientWidth: width, clientHeight: height } = this.container;
    this.renderer.setSize(width, height);
    this.camera.aspect = width / Math.max(height, 1);
    this.camera.updateProjectionMatrix();
  }

  // Take a robot with its ground in place of the last.
  show(robot) {
    this.world.clear();
    this.world.add(this.arrow);
    this.floor?.removeFromParent();
    this.robot = robot;
    this.focus = [robot.data.qpos[0], robot.data.qpos[1]];
    this.texture = tiles();
    this.floor = robot.ground.uneven ? this.heightField(robot.ground) : this.plane();
    this.floor.receiveShadow = true;
    const { model } = robot;
    this.limbs = [];
    for (let i = 0; i < model.ngeom; i++) {
      const geometry = this.shape(model, i);
      if (geometry === null) continue;
      const name = model.body(model.geom_bodyid[i]).name;
      const side = ['right', 'left'].find((each) => name.startsWith(each)) ?? 'middle';
      const mesh = new THREE.Mesh(geometry, new THREE.MeshStandardMaterial({ color: COLOURS[side], roughness: 0.6 }));
      mesh.castShadow = true;
      mesh.matrixAutoUpdate = false;
      this.world.add(mesh);
      this.limbs.push([mesh, i]);
    }
  }

  shape(model, i) {
    const [a, b, c] = model.geom_size.slice(3 * i, 3 * i + 3);
    if (model.geom_bodyid[i] === 0) return null; // the ground
    if (model.geom_type[i] === 2) return new THREE.SphereGeometry(a, 32, 20);
    if (model.geom_type[i] === 3) return new THREE.CapsuleGeometry(a, 2 * b, 8, 24).rotateX(Math.PI / 2);
    return a < 0.01 ? null : new THREE.BoxGeometry(2 * a, 2 * b, 2 * c); // but the studs at the soles' corners
  }

  plane() {
    this.texture.repeat.set(60 / TILE, 60 / TILE);
    const material = new THREE.MeshStandardMaterial({ map: this.texture, roughness: 1 });
    const mesh = new THREE.Mesh(new THREE.PlaneGeometry(60, 60), material);
    this.scene.add(mesh); // stays below the camera, and its tiles move
    return mesh;
  }

  heightField(ground) {
    const { columns, rows, cell, corner } = ground;
    const positions = [];
    const places = [];
    const triangles = [];
    for (let j = 0; j < rows; j++) {
      for (let i = 0; i < columns; i++) {
        const [x, y] = [corner[0] + i * cell, corner[1] + j * cell];
        positions.push(x, y, ground.vertex(i, j));
        places.push(x / TILE, y / TILE);
        if (i + 1 === columns || j + 1 === rows) continue;
        const low = j * columns + i;
        triangles.push(low, low + 1, low + columns + 1, low, low + columns + 1, low + columns);
      }
    }
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute('position', new THREE.Float32BufferAttribute(positions, 3));
    geometry.setAttribute('uv', new THREE.Float32BufferAttribute(places, 2));
    geometry.setIndex(triangles);
    geometry.computeVertexNormals();
    const material = new THREE.MeshStandardMaterial({ map: this.texture, roughness: 1, flatShading: true });
    const mesh = new THREE.Mesh(geometry, material);
    this.world.add(mesh);
    return mesh;
  }

  // The robot has gone on a period back.
  shift([x, y]) {
    this.focus[0] += x;
    this.focus[1] += y;
  }

  draw(seconds) {
    const { data, pushed, ground, time } = this.robot;
    // Follows a little softly, so that the sway of a step is seen.
    const share = 1 - Math.exp(-seconds / 0.15);
    for (const axis of [0, 1]) this.focus[axis] += share * (data.qpos[axis] - this.focus[axis]);
    const [x, y] = this.focus;
    this.world.position.set(-x, -y, 0);
    if (!ground.uneven) this.texture.offset.set((x - 30) / TILE % 1, (y - 30) / TILE % 1);
    const [positions, turns] = [data.geom_xpos, data.geom_xmat];
    for (const [mesh, i] of this.limbs) {
      const [p, m] = [positions.subarray(3 * i, 3 * i + 3), turns.subarray(9 * i, 9 * i + 9)];
      mesh.matrix.set(m[0], m[1], m[2], p[0], m[3], m[4], m[5], p[1], m[6], m[7], m[8], p[2], 0, 0, 0, 1);
    }
    this.arrow.visible = pushed !== null && time - pushed.time < ARROW_SHOWN;
    if (this.arrow.visible) {
      const direction = new THREE.Vector3(...pushed.force).normalize();
      this.arrow.setDirection(direction);
      this.arrow.position.set(data.qpos[0], data.qpos[1], data.qpos[2] + 0.35).addScaledVector(direction, -0.85);
    }
    this.controls.update();
    this.renderer.render(this.scene, this.camera);
  }
}
