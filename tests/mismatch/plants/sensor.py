"""A depth camera over a stored truth: which points of the upper face a frame shows, and with what errors.

The camera looks from beyond the free edge. Pixels are cast at a fine triangulation of both quadratic faces and the
rim; what the lower face, the rim or the tool hides is not there. All errors are drawn per case or per recording from
a generator that knows nothing of the effect."""
import numpy as np

FINE = 6  # triangles along a side of a cell: chords are 0.01 mm off the parabola
PITCH_M = 0.9e-3  # of the pixels, on the sheet


def fine_lines(xs):
    """Matrix from nodes on and between the lines xs to FINE pieces of each cell."""
    n = len(xs) - 1
    P = np.zeros((FINE * n + 1, 2 * n + 1))
    for cell in range(n):
        for k in range(FINE + 1):
            s = k / FINE
            P[FINE * cell + k, 2 * cell:2 * cell + 3] = (1 - s) * (1 - 2 * s), 4 * s * (1 - s), s * (2 * s - 1)
    return P


def strip_triangles(grid):
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[:-1, 1:], grid[1:, 1:]
    return np.concatenate([np.stack([a, b, d], -1).reshape(-1, 3), np.stack([a, d, c], -1).reshape(-1, 3)])


class Body:
    """Triangles of the sheet and which of them belong to the upper face beside the clamped strip."""

    def __init__(self, xs, ys, strip):
        self.Px, self.Py = fine_lines(xs), fine_lines(ys)
        n, m = len(self.Px), len(self.Py)
        numbers = np.arange(2 * n * m).reshape(2, n, m)
        rims = [strip_triangles(numbers[:, 0]), strip_triangles(numbers[:, -1]), strip_triangles(numbers[:, :, 0]),
                strip_triangles(numbers[:, :, -1])]
        upper = strip_triangles(numbers[1])
        self.triangles = np.concatenate([upper, strip_triangles(numbers[0]), *rims])
        y = self.Py @ np.sort(np.concatenate([ys, (ys[1:] + ys[:-1]) / 2]))
        first = np.take(np.tile(y, 2 * n), self.triangles).min(axis=1)
        self.seen = (np.arange(len(self.triangles)) < len(upper)) & (first > strip - 1e-9)

    def vertices(self, faces):
        """faces [lower, upper][x][y][xyz] of the nodes -> [vertex][xyz]."""
        return np.einsum("ax,fxyd,by->fabd", self.Px, faces, self.Py, optimize=True).reshape(-1, 3)


class Camera:
    def __init__(self, position, view, pitch):
        """pitch: tangent between neighbouring pixels."""
        self.position, self.pitch = position, pitch
        right = np.cross(view, [0, 0, 1])
        right /= np.linalg.norm(right)
        self.axes = np.stack([right, np.cross(view, right), view])  # rows: to the right, down, away

    def pixels(self, points):
        p = (points - self.position) @ self.axes.T
        return p[..., :2] / p[..., 2:] / self.pitch, p[..., 2]

    def frame(self, vertices, body, tool):
        """Pixels [n][2] and depths [n] of what is seen of the upper face; tool: spheres (centres, radii)."""
        px, depth = self.pixels(vertices)
        low = np.floor(px.min(axis=0)).astype(int) - 1
        width, height = np.ceil(px.max(axis=0)).astype(int) + 2 - low
        nearest = np.full(width * height, np.inf)
        t = body.triangles
        a, b, c = px[t[:, 0]], px[t[:, 1]], px[t[:, 2]]
        inverse = 1 / depth[t]  # linear over the image
        area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
        corner = np.floor(np.minimum(np.minimum(a, b), c)).astype(int)
        reach = int(np.ceil((np.maximum(np.maximum(a, b), c) - corner).max())) + 1
        ids, places, depths = [], [], []
        with np.errstate(divide="ignore", invalid="ignore"):
            for i in range(reach):
                for j in range(reach):
                    p = corner + [i, j]
                    wb = ((p[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (p[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])) / area
                    wc = ((b[:, 0] - a[:, 0]) * (p[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (p[:, 0] - a[:, 0])) / area
                    hit = np.flatnonzero((wb >= 0) & (wc >= 0) & (wb + wc <= 1))
                    z = 1 / (inverse[hit, 0] + wb[hit] * (inverse[hit, 1] - inverse[hit, 0]) + wc[hit] * (inverse[hit, 2] - inverse[hit, 0]))
                    ids.append(hit)
                    places.append((p[hit, 0] - low[0]) * height + p[hit, 1] - low[1])
                    depths.append(z)
        ids, places, depths = (np.concatenate(v) for v in (ids, places, depths))
        np.minimum.at(nearest, places, depths)
        front = (depths == nearest[places]) & body.seen[ids]
        place, first = np.unique(places[front], return_index=True)
        z = depths[front][first]
        pixel = np.stack([place // height + low[0], place % height + low[1]], axis=1)
        centres, radii = tool
        at, far = self.pixels(centres)
        away = np.linalg.norm(pixel[:, None] - at[None], axis=2)
        hidden = ((away < radii / far / self.pitch) & (far - radii < z[:, None])).any(axis=1)
        return pixel[~hidden], z[~hidden], hidden.mean() if len(hidden) else 0.0

    def points(self, pixel, depth):
        return self.position + np.concatenate([pixel * self.pitch, np.ones((len(pixel), 1))], axis=1) * depth[:, None] @ self.axes


def draw(rng):
    """Numbers of a camera and its errors."""
    u = rng.uniform
    axis = rng.normal(size=3)
    shift = rng.normal(size=3)
    return {
        "distance_m": u(.30, .37), "azimuth_deg": u(-30, 30), "elevation_deg": u(48, 66), "points": int(rng.integers(750, 1400)),
        "noise_m": u(.0005, .0011), "flying_share": .05, "step_m": .00025,
        "bias_m": u(-.00015, .00015), "bias_slope": u(-.001, .001),
        "registration_m": (shift / np.linalg.norm(shift) * u(0, .002)).tolist(),
        "registration_rad": (axis / np.linalg.norm(axis) * np.radians(u(0, 1))).tolist(),
        "tool_half_angle_deg": u(5, 12), "force_noise_N": u(.008, .02), "force_bias_N": rng.normal(0, .005, 3).tolist()}


def tool_spheres(tip, shaft, half_angle_deg):
    """A cone of tool over the tip, as spheres."""
    s = np.concatenate([[0.0], np.geomspace(.002, .15, 40)])
    return tip + s[:, None] * shaft, .0025 + s * np.tan(np.radians(half_angle_deg))


def observe(camera, numbers, pixel, depth, rng):
    """Points in the camera's believed world: some pixels, noise along the ray, steps, strays."""
    count = min(len(depth), int(round(numbers["points"] * rng.uniform(.97, 1.03))))
    chosen = rng.permutation(len(depth))[:count]
    pixel, depth = pixel[chosen], depth[chosen]
    z0 = numbers["distance_m"]
    seen = depth + rng.normal(0, 1, count) * numbers["noise_m"] * (depth / .35)**2
    seen = seen + numbers["bias_m"] * ((depth - z0) / .05)**2 + numbers["bias_slope"] * (depth - z0)
    stray = rng.random(count) < numbers["flying_share"]
    seen = np.where(stray, seen + rng.choice([-1, 1], count) * rng.uniform(.004, .03, count), seen)
    return camera.points(pixel, np.rint(seen / numbers["step_m"]) * numbers["step_m"])
