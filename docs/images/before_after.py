#!/usr/bin/env python3
"""Draws docs/images/before_after.png: the strips of samples/airborne before and after `tieline run`.

    tieline run samples/airborne/project.toml --out out/sample
    python3 docs/images/before_after.py samples/airborne/strips out/sample/corrected page.html
    chromium --headless --hide-scrollbars --window-size=1400,1070 --screenshot=docs/images/before_after.png page.html

Shares no code with tieline: strips are gridded to cells of 1.5 m, every strip with 7 or more last returns in a cell gets a
plane, and the map shows the height of the highest plane above the lowest one.
Needs: pip install "laspy[lazrs]" numpy pillow
"""
import base64
import glob
import io
import sys

import laspy
import numpy as np
from PIL import Image

HALF_M, CELL_M, LIMIT_M = 84.0, 1.5, 0.2
HOUSE_M = (47.5, 60.5)  # the roof of the section
STRIP_COLOURS = ["#1b6fb3", "#d9730d", "#2f8f5b", "#b0307a", "#6b5bd2"]
RAMP = [(0.0, (247, 251, 255)), (0.15, (198, 219, 239)), (0.35, (107, 174, 214)), (0.65, (33, 113, 181)), (1.0, (8, 29, 88))]


def load(folder):
    strips = []
    for path in sorted(glob.glob(folder + "/*.la[sz]")):
        las = laspy.read(path)
        last = np.asarray(las.return_number) == np.asarray(las.number_of_returns)
        strips.append((np.column_stack([las.x, las.y, las.z])[last], np.asarray(las.classification)[last]))
    return strips


def heights(xyz, n):
    """Height of the plane of each cell at its centre; NaN where there is none or it is rough."""
    ij = np.floor((xyz[:, :2] + HALF_M) / CELL_M).astype(int)
    inside = ((ij >= 0) & (ij < n)).all(1)
    xyz, ij = xyz[inside], ij[inside]
    key = ij[:, 1] * n + ij[:, 0]
    u, v = ((xyz[:, :2] + HALF_M) / CELL_M - ij - 0.5).T
    z = xyz[:, 2]
    total = lambda values: np.bincount(key, values, n * n)
    columns = [np.ones_like(u), u, v]
    normal = np.array([[total(a * b) for b in columns] for a in columns]).transpose(2, 0, 1)
    right = np.array([total(a * z) for a in columns]).T
    count = normal[:, 0, 0]
    good = count >= 7
    good &= np.linalg.cond(np.where(good[:, None, None], normal, np.eye(3))) < 1e3
    plane = np.full((n * n, 3), np.nan)
    plane[good] = np.linalg.solve(normal[good], right[good][..., None])[..., 0]
    residual = z - (plane[key, 0] + plane[key, 1] * u + plane[key, 2] * v)
    rough = np.sqrt(total(np.nan_to_num(residual) ** 2) / np.maximum(count - 3, 1))
    return np.where(good & (rough < 0.03), plane[:, 0], np.nan).reshape(n, n)


def spread(strips):
    n = int(2 * HALF_M / CELL_M)
    planes = np.array([heights(xyz, n) for xyz, _ in strips])
    several = (~np.isnan(planes)).sum(0) >= 2
    low = np.where(several, np.nanmin(np.where(np.isnan(planes), np.inf, planes), 0), np.nan)
    high = np.where(several, np.nanmax(np.where(np.isnan(planes), -np.inf, planes), 0), np.nan)
    return high - low


def colour(t):
    places = [p for p, _ in RAMP]
    return np.stack([np.interp(t, places, [c[k] for _, c in RAMP]) for k in range(3)], -1)


def picture(values):
    rgb = colour(np.clip(np.nan_to_num(values) / LIMIT_M, 0, 1))
    rgb[np.isnan(values)] = (214, 214, 214)
    image = Image.fromarray(rgb.astype(np.uint8)[::-1])
    buffer = io.BytesIO()
    image.resize((image.width * 5, image.height * 5), Image.NEAREST).save(buffer, "PNG")
    return base64.b64encode(buffer.getvalue()).decode()


def section(strips, frame, width, height):
    """Points of a slab of 2 m across the ridge, coloured by strip, to scale."""
    centre, across, half_m, base_m = frame
    scale = width / (2 * half_m)
    dots = []
    for (xyz, _), fill in zip(strips, STRIP_COLOURS):
        d = xyz[:, :2] - centre
        s, t = d @ across, d @ np.array([-across[1], across[0]])
        keep = (np.abs(t) < 1.0) & (np.abs(s) < half_m) & (xyz[:, 2] > base_m)
        for x, z in zip(s[keep], xyz[keep, 2]):
            dots.append(f'<circle cx="{(x + half_m) * scale:.1f}" cy="{height - (z - base_m) * scale:.1f}" r="3" fill="{fill}"/>')
    bar = f'<path d="M12 14h{scale:.1f}" stroke="#333" stroke-width="3"/><text x="{20 + scale:.0f}" y="19">1 m</text>'
    return f'<svg width="{width}" height="{height}">{"".join(dots)}{bar}</svg>'


def house(strips):
    """Middle, direction across the ridge, half width and lowest height of the section."""
    points = np.vstack([xyz[classes == 6] for xyz, classes in strips])
    near = points[np.hypot(*(points[:, :2] - HOUSE_M).T) < 14.0]
    centre = near[:, :2].mean(0)
    _, vectors = np.linalg.eigh(np.cov((near[:, :2] - centre).T))
    return centre, vectors[:, 0], 4.0, np.percentile(near[:, 2], 99.9) - 2.75


def panel(title, strips, frame, median_mm):
    return (
        f'<div><h2>{title}</h2><img src="data:image/png;base64,{picture(spread(strips))}" width="672" height="672">'
        f"<p>median {median_mm:.0f} mm</p>{section(strips, frame, 672, 240)}</div>"
    )


def main():
    before, after = load(sys.argv[1]), load(sys.argv[2])
    frame = house(before)
    medians = [np.nanmedian(spread(strips)) * 1e3 for strips in (before, after)]
    steps = ",".join("rgb(%d,%d,%d) %d%%" % (*c, p * 100) for p, c in RAMP)
    keys = "".join(f'<b style="color:{c}">●</b> {k + 1} ' for k, c in enumerate(STRIP_COLOURS))
    page = f"""<!doctype html><meta charset="utf-8"><style>
body{{margin:0;padding:14px 18px;width:1364px;font:17px sans-serif;color:#222;background:#fff}}
.two{{display:flex;gap:20px}} h2{{font-size:22px;margin:0 0 6px}} img{{display:block;image-rendering:pixelated}} p{{margin:6px 0}}
.key{{display:flex;gap:14px;align-items:center;margin-top:10px}} .bar{{width:260px;height:16px;background:linear-gradient(90deg,{steps})}}
svg{{background:#f6f7f8;font:14px sans-serif}}</style>
<div class="two">{panel("As delivered", before, frame, medians[0])}{panel("After tieline run", after, frame, medians[1])}</div>
<div class="key"><span>Maps: how far apart the strips lie, highest − lowest</span><span>0</span><div class="bar"></div><span>{LIMIT_M * 1e3:.0f} mm</span>
<span style="background:#d6d6d6;width:16px;height:16px"></span><span>no common smooth surface</span></div>
<div class="key"><span>Sections: 2 m of a roof, to scale, points by strip {keys}</span></div>"""
    with open(sys.argv[3], "w", encoding="utf-8") as out:
        out.write(page)
    print("median of the spread, before and after [mm]:", *(f"{m:.1f}" for m in medians))


if __name__ == "__main__":
    main()
