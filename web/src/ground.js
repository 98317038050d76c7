// The ground: a plane at height 0, or a height field that repeats itself, so that nobody comes to its end.

export class Ground {
  constructor(model) {
    this.uneven = model.nhfield > 0;
    if (!this.uneven) return;
    [this.columns, this.rows] = [model.hfield_ncol[0], model.hfield_nrow[0]];
    const [halfLength, halfWidth, range] = model.hfield_size;
    const geom = [...model.geom_type].indexOf(1); // mjGEOM_HFIELD
    const [x, y, z] = model.geom_pos.slice(3 * geom, 3 * geom + 3);
    this.corner = [x - halfLength, y - halfWidth];
    this.cell = (2 * halfLength) / (this.columns - 1);
    // It holds two periods along each axis: a robot that leaves the middle goes on a period back.
    this.period = [halfLength, halfWidth];
    this.middle = [x, y];
    this.heights = Float64Array.from(model.hfield_data, (share) => z + range * share);
  }

  vertex(i, j) {
    return this.heights[j * this.columns + i];
  }

  // Height of the surface [m]; each cell is cut along the diagonal from its corner with the smallest x and y.
  height(x, y) {
    if (!this.uneven) return 0;
    const across = (x - this.corner[0]) / this.cell;
    const up = (y - this.corner[1]) / this.cell;
    const i = Math.min(Math.max(Math.floor(across), 0), this.columns - 2);
    const j = Math.min(Math.max(Math.floor(up), 0), this.rows - 2);
    const [u, v] = [across - i, up - j];
    const [low, far] = [this.vertex(i, j), this.vertex(i + 1, j)];
    const [left, opposite] = [this.vertex(i, j + 1), this.vertex(i + 1, j + 1)];
    if (u > v) return far + (opposite - far) * v - (far - low) * (1 - u);
    return left + (opposite - left) * u - (left - low) * (1 - v);
  }

  // Where a robot at x, y has to be put so that it never comes to the end: a shift of whole periods [m].
  shift(x, y) {
    if (!this.uneven) return [0, 0];
    return [x, y].map((at, axis) => {
      const off = at - this.middle[axis];
      return Math.abs(off) > this.period[axis] / 2 ? -Math.sign(off) * this.period[axis] : 0;
    });
  }
}
