"""Tracker, depth maps, terrain."""

from __future__ import annotations

from pathlib import Path

import iclk
import numpy as np
import pytest
import rasterio
from conftest import Scene, make_scene, needs_vulkan, pose


def steps(count: int) -> list[np.ndarray]:
    return [pose((0.03 * i, -0.01 * i, 0.02 * i), (0.004 * i, 0.006 * i, -0.005 * i + 1e-9)) for i in range(count)]


def frames(count: int) -> list[Scene]:
    """What the cameras of steps() see of one plane; each reference is the first."""
    return [make_scene(160, 120, T_10=T) for T in steps(count)]


def test_a_tracker_follows(device: str | None) -> None:
    seen = frames(4)
    tracker = iclk.Tracker(seen[0].K, device=device, depth_sigma="rendered", features=100)
    first = tracker.track(seen[0].reference, seen[0].depth, 0.0)
    assert first.status == "keyframe" and not first.lost
    for i, s in enumerate(seen[1:], 1):
        frame = tracker.track(s.target, None, 0.1 * i)
        assert frame.status in ("tracked", "keyframe") and frame.confirmed, frame.reason
        assert s.error(np.linalg.inv(frame.T_WC)) < 0.3
    lost = tracker.track(np.zeros((120, 160), np.uint8), None, 1.0)
    assert lost.lost and lost.reason
    assert tracker.keyframe_poses().shape[1:] == (4, 4)
    with pytest.raises(ValueError, match="does not come after"):
        tracker.track(seen[0].reference, seen[0].depth, 0.5)
    with pytest.raises(ValueError, match="160x120"):
        tracker.track(seen[0].reference[1:], None, 2.0)
    assert first.origin is None and first.before is None and not first.covariance.any()


def test_a_tracker_takes_features() -> None:
    seen = frames(3)
    points = np.column_stack([seen[0].uv, seen[0].z])
    unusable = [[-5, 3, 1], [80, 60, np.nan], [80, 60, 0], [np.inf, 0, 1]]
    inputs = [points, np.vstack([points, unusable]), np.column_stack([points, np.full(len(points), 1e-4)])]
    for features in inputs:
        tracker = iclk.Tracker(seen[0].K, model="classical", device="cpu", depth_sigma="rendered", features=100)
        assert tracker.track(seen[0].reference, None, 0.0, features=features).status == "keyframe"
        for i, s in enumerate(seen[1:], 1):
            frame = tracker.track(s.target, None, 0.1 * i)
            assert frame.confirmed and frame.features == min(100, len(points)), frame.reason
            assert s.error(np.linalg.inv(frame.T_WC)) < 0.3
        for bad in (points[:, :2], points[0], np.column_stack([points, np.full(len(points), -1.0)])):
            with pytest.raises(ValueError, match=r"N x 3|sigma"):
                tracker.track(seen[2].target, None, 1.0, features=bad)


def test_a_trackers_model_is_auto(monkeypatch: pytest.MonkeyPatch) -> None:
    s = frames(1)[0]
    assert not iclk.Tracker(s.K, device="cpu").track(s.reference, s.depth, 0.0).lost
    monkeypatch.setenv("ICLK_MODEL", "no-model")
    with pytest.raises(iclk.Error, match="no-model"):
        iclk.Tracker(s.K, device="cpu").track(s.reference, s.depth, 0.0)


def test_a_trackers_mask_is_of_the_images_size() -> None:
    s = frames(1)[0]
    tracker = iclk.Tracker(s.K, device="cpu", features=100, readout=0.03, masks=True, depth_sigma="auto")
    with pytest.raises(ValueError, match="a mask of 2000000x2"):
        tracker.track(s.reference, s.depth, 0.0, mask=np.full((2, 2000000), True))
    with pytest.raises(ValueError, match="time is nan"):
        tracker.track(s.reference, s.depth, float("nan"))
    assert not tracker.track(s.reference, s.depth, 0.0, mask=np.full((120, 160), True)).lost


def test_a_tracker_goes_on_from_its_state() -> None:
    seen = frames(3)

    def make() -> iclk.Tracker:
        return iclk.Tracker(seen[0].K, device="cpu", depth_sigma="rendered", features=100)

    one, other = make(), make()
    one.track(seen[0].reference, seen[0].depth, 0.0)
    first = one.track(seen[1].target, None, 0.1)
    state = one.state()
    other.restore(state)
    a, b = (t.track(seen[2].target, None, 0.2) for t in (one, other))
    np.testing.assert_array_equal(a.T_WC, b.T_WC)
    later = make()
    later.start_in(state)
    again = later.track(seen[1].target, None, -5.0)  # another clock, and any place of the map
    assert not again.lost
    np.testing.assert_allclose(again.T_WC, first.T_WC, atol=0.01)
    with pytest.raises(ValueError):
        one.restore(b"nothing of the kind")
    with pytest.raises(ValueError, match="depth-sigma"):
        iclk.Tracker(seen[0].K, device="cpu", depth_sigma="good").track(seen[0].reference, seen[0].depth, 0)


@needs_vulkan
def test_a_depth_map_is_that_of_the_plane() -> None:
    s = make_scene(160, 120, T_10=pose((-0.25, 0.01, 0.0), (0.001, 0.002, 0.001)))
    for how in ({"near": 3.0, "far": 6.0}, {"uv": s.uv, "depth": s.z}):
        m = iclk.depth_map(s.reference, [(s.target, s.T_10)], s.K, **how)
        assert m.depth.shape == m.confidence.shape == s.depth.shape and m.depth.dtype == np.float32
        known = m.depth > 0
        assert m.valid == pytest.approx(known.mean()) and m.valid > 0.8
        assert m.status == "converged" and "% of the pixels" in m.reason
        assert np.median(np.abs(m.depth - s.depth)[known] / s.depth[known]) < 0.01
    lied = iclk.depth_map(s.reference, [(s.target, s.T_10)], s.K, near=2, far=20, uv=s.uv, depth=2 * s.z)
    assert lied.status == "diverged" and "sparse depths" in lied.reason
    filled = iclk.depth_map(s.reference, [(s.target, s.T_10)], s.K, near=3, far=6, fill=True)
    assert (filled.depth > 0).all()
    for wrong, words in (
        ({}, "near and far"),
        ({"near": -1.0}, "positive"),
        ({"far": 3.0}, "far needs near"),
        ({"near": 6.0, "far": 3.0}, "far|near"),
        ({"near": 3.0, "uv": s.uv}, "both uv and depth"),
        ({"near": 3.0, "device": "cpu"}, "Vulkan"),
        ({"near": 3.0, "planes": 7}, "planes"),
    ):
        with pytest.raises(ValueError, match=words):
            iclk.depth_map(s.reference, [(s.target, s.T_10)], s.K, **wrong)
    with pytest.raises(ValueError, match="move"):
        iclk.depth_map(s.reference, [(s.target, np.eye(4))], s.K, near=3.0)
    with pytest.raises(ValueError):
        iclk.depth_map(s.reference, [], s.K, near=3.0)


@needs_vulkan
def test_terrain_gives_pairs_with_truth() -> None:
    K, width, height = (150, 150, 79.5, 59.5), 160, 120
    terrain = iclk.Terrain(seed=3, size=96)
    p = terrain.pair(1, K, width, height, altitude=(30, 40), translation=1.0)
    assert p.reference.shape == (height, width, 3) and p.depth.shape == (height, width) and (p.depth > 0).all()
    np.testing.assert_allclose(np.linalg.inv(p.T_W1) @ p.T_W0, p.T_10, atol=1e-9)
    image, depth = terrain.render(p.T_W0, K, width, height)
    np.testing.assert_array_equal(image, p.reference)
    np.testing.assert_array_equal(depth, p.depth)
    uv, z = iclk.detect(p.reference, p.depth, 100)
    scene = Scene(p.reference, p.target, p.depth, K, p.T_10, uv, z)
    r = iclk.align(p.reference, p.target, uv, z, K, model="classical")
    assert r.converged and scene.error(r.T_10) < 0.5
    assert np.isnan(terrain.height_at(-1, 0)) and np.isfinite(terrain.height_at(48, 48))
    with pytest.raises(ValueError, match="ground"):
        terrain.render(np.eye(4), K, width, height)
    with pytest.raises(ValueError, match="cpu"):
        iclk.Terrain(device="cpu")


def make_map(step: float = 0.5, side: float = 160.0) -> tuple[np.ndarray, np.ndarray, tuple[float, ...], tuple[float, ...]]:
    """A smooth random picture over hills; the heights are coarser."""
    random = np.random.default_rng(3)
    count = int(side / step)
    picture = np.zeros((count, count, 3))
    for cells in (12, 30, 70):
        noise = random.uniform(-1, 1, (cells, cells, 3))
        rows = np.linspace(0, cells - 1.001, count)
        whole, part = rows.astype(int), (rows % 1)[:, None]
        along = noise[whole] * (1 - part[..., None]) + noise[np.minimum(whole + 1, cells - 1)] * part[..., None]
        picture += along[:, whole] * (1 - part[None]) + along[:, np.minimum(whole + 1, cells - 1)] * part[None]
    y, x = np.mgrid[side - 1 : 0 : -2, 1:side:2]
    heights = 20 + 5 * np.sin(x / 17) * np.cos(y / 23)
    left, top = 500000.0, 5300000.0
    return (
        np.clip(128 + 50 * picture, 0, 255).astype(np.uint8),
        heights,
        (left, step, 0, top, 0, -step),
        (left, 2, 0, top, 0, -2),
    )


def above(east: float, north: float, height: float) -> np.ndarray:
    """Looking straight down, north up."""
    T = np.diag([1.0, -1.0, -1.0, 1.0])
    T[:3, 3] = 500000 + east, 5300000 - 160 + north, height
    return T


@needs_vulkan
def test_a_picture_is_located_on_a_map() -> None:
    ortho, heights, place, heights_place = make_map()
    m = iclk.Map(ortho, heights, place, heights_place, model="classical")
    K, truth = (300, 300, 159.5, 119.5), above(80, 75, 70)
    image, depth = m.view(truth, K, 320, 240)
    assert image.shape == (240, 320, 3) and abs(depth[120, 160] - 50) < 6
    prior = truth.copy()
    prior[:3, 3] += 3, -4, 2
    located = m.locate(image, K, prior, sigma=(4, 2))
    assert located.converged, located.reason
    assert np.linalg.norm(located.position - truth[:3, 3]) < 0.1
    assert located.covariance.shape == (6, 6) and np.all(np.diag(located.covariance) > 0)
    X, C = m.ground(located, K, 320, 240, [[159.5, 119.5], [20, 30]])
    assert np.linalg.norm(X[0, :2] - truth[:2, 3]) < 0.2 and C.shape == (2, 3, 3) and C[0, 0, 0] > 0
    assert not m.locate(image[::-1, ::-1].copy(), K, prior, sigma=(1, 1)).converged
    with pytest.raises(ValueError, match="not located"):
        m.ground(m.locate(np.zeros((240, 320), np.uint8), K, prior, sigma=(1, 1)), K, 320, 240, [[1, 1]])


@needs_vulkan
def test_map_files_whose_units_are_no_metres_are_refused(tmp_path: Path) -> None:
    ortho, heights, place, heights_place = make_map(side=40)

    def write(name: str, bands: np.ndarray, where: tuple[float, ...], crs: str, unit: str = "") -> str:
        size = {"count": bands.shape[0], "height": bands.shape[1], "width": bands.shape[2], "dtype": bands.dtype}
        transform = rasterio.Affine.from_gdal(*where)
        with rasterio.open(tmp_path / name, "w", driver="GTiff", crs=crs, transform=transform, **size) as file:
            file.write(bands)
            if unit:
                file.units = [unit]
        return str(tmp_path / name)

    def files(crs: str, other: str = "", unit: str = "") -> tuple[str, str]:
        return (write("ortho.tif", np.moveaxis(ortho, -1, 0), place, crs),
                write("dsm.tif", heights[None].astype(np.float32), heights_place, other or crs, unit))

    iclk.Map(*files("EPSG:32633"), model="classical")
    for crs, other, unit, words in (
        ("EPSG:3857", "", "", "metres"),
        ("EPSG:2263", "", "", "metres"),
        ("EPSG:4326", "", "", "4326"),
        ("EPSG:32633", "EPSG:32632", "", "32632"),
        ("EPSG:32633", "", "ft", "'ft'"),
    ):
        with pytest.raises(ValueError, match=words):
            iclk.Map(*files(crs, other, unit))


@needs_vulkan
def test_a_frame_that_the_map_does_not_show_gets_a_pose() -> None:
    ortho, heights, place, heights_place = make_map()
    whole = iclk.Map(ortho, heights, place, heights_place, model="classical")
    hole = np.dstack([ortho, np.full(ortho.shape[:2], 255, np.uint8)])
    hole[:, 170:] = 0  # from 85 m east on
    m = iclk.Map(hole, heights, place, heights_place, model="classical")
    K = (300, 300, 159.5, 119.5)
    sequence = m.sequence(K)
    with pytest.raises(ValueError, match="prior"):
        sequence.locate(np.zeros((240, 320), np.uint8), 0.0)
    sequence = m.sequence(K)
    truth = [above(45 + 3 * i, 80, 70) for i in range(20)]
    for i, T in enumerate(truth):
        image, _ = whole.view(T, K, 320, 240)
        pose = sequence.locate(image, 0.1 * i, T if i == 0 else None, sigma=(4, 2))
        assert pose.known and pose.covariance.shape == (6, 6)
        with pytest.raises(ValueError, match="come after"):
            sequence.locate(image, 0.1 * i)  # changes nothing
    poses = sequence.all()
    assert len(poses) == len(truth)
    assert poses[0].located.converged and not poses[-1].located.converged
    for pose, T in zip(poses, truth):
        assert pose.known and np.linalg.norm(pose.T_WC[:3, 3] - T[:3, 3]) < 1


def test_a_map_that_cannot_be_is_refused() -> None:
    ortho, heights, place, heights_place = make_map(side=40)
    with pytest.raises(ValueError, match="north up"):
        iclk.Map(ortho, heights, (0, 1, 0.1, 0, 0, -1), heights_place)
    with pytest.raises(ValueError, match="six numbers"):
        iclk.Map(ortho, heights)
    with pytest.raises(ValueError, match="uint8"):
        iclk.Map(ortho.astype(float), heights, place, heights_place)
    with pytest.raises(ValueError, match="lavapipe"):
        iclk.Map(ortho, heights, place, heights_place, device="cpu")
