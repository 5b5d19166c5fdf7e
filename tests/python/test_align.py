"""iclk.align and iclk.Aligner: right poses, statuses as values, clear errors."""

from __future__ import annotations

import pickle

import iclk
import numpy as np
import pytest
from conftest import VULKAN, Scene, make_scene, pose


def test_the_pose_is_right(scene: Scene, device: str | None) -> None:
    r = iclk.align(scene.reference, scene.target, scene.uv, scene.z, scene.K, device=device, model="classical")
    assert r.converged and r.status == "converged", r.reason
    assert scene.error(r.T_10) < 0.05
    assert r.aligned.sum() > 80 and r.uv.shape == scene.uv.shape
    assert r.model == "classical" and r.attempts[-1].status == "converged"
    assert [s.name for s in r.stages] == ["iclk", "feature_alignment", "pose", "rivals"]
    np.testing.assert_array_equal(r.T_10[3], (0, 0, 0, 1))
    # The covariance speaks of this error.
    assert np.all(np.linalg.eigvalsh(r.covariance) > 0)
    assert np.abs(r.T_10 - scene.T_10)[:3, 3].max() < 6 * np.sqrt(r.covariance.diagonal()[:3].max())


def test_features_are_chosen_in_a_depth_map(colour: Scene, device: str | None) -> None:
    r = iclk.align(colour.reference, colour.target, None, colour.depth, colour.K, device=device, count=120)
    assert r.converged and len(r.uv) == 120 and colour.error(r.T_10) < 0.1
    uv, z = iclk.detect(colour.reference, colour.depth, 120)
    assert len(uv) == 120 and np.array_equal(uv, uv.round())
    np.testing.assert_allclose(z, colour.depth[uv[:, 1].astype(int), uv[:, 0].astype(int)], rtol=1e-6)
    hole = colour.depth.copy()
    hole[:, :160] = np.nan
    assert (iclk.detect(colour.reference, hole)[0][:, 0] >= 160).all()


def test_detectors_and_what_is_not_to_be_looked_at(colour: Scene) -> None:
    mask = np.ones(colour.depth.shape, bool)
    mask[:, :160] = False
    for detector in ("shi-tomasi", "grid", "random"):
        uv, _ = iclk.detect(colour.reference, colour.depth, 50, detector=detector, mask=mask)
        assert len(uv) > 10 and (uv[:, 0] >= 163).all()
    first, second = (iclk.detect(colour.reference, colour.depth, 50, detector="random", seed=i)[0] for i in (1, 2))
    assert len(first) == 50 and not np.array_equal(first, second)
    for wrong, words in (
        ({"detector": "sift"}, "'sift' is not known"),
        ({"count": 0}, "feature count 0"),
        ({"mask": mask[1:]}, "320x239"),
    ):
        with pytest.raises(ValueError, match=words):
            iclk.detect(colour.reference, colour.depth, **wrong)
    with pytest.raises(ValueError, match="320x239"):
        iclk.detect(colour.reference, colour.depth[1:])


def test_a_batch_has_the_answers_of_its_pairs(small: Scene, device: str | None) -> None:
    other = make_scene(160, 120, seed=5, T_10=pose((-0.1, 0.02, 0.0), (0.0, -0.02, 0.01)))
    aligner = iclk.Aligner(160, 120, "classical", device, references=2, batch=3)
    assert set(aligner.set_reference(0, small.reference, small.uv, small.z, small.K)) == {"ok"}
    aligner.set_reference(1, other.reference, None, other.depth, other.K)
    pairs = [(0, small.target), (1, other.target), iclk.Pair(0, small.target, small.T_10), (0, other.target)] * 2
    results = aligner.align_batch(pairs)
    assert [r.converged for r in results] == [True, True, True, False] * 2
    assert small.error(results[0].T_10) < 0.1 and other.error(results[1].T_10) < 0.1
    alone = aligner.align(1, other.target)
    for a, b in ((results[1], alone), (results[1], results[5])):
        np.testing.assert_array_equal(a.T_10, b.T_10)
        np.testing.assert_array_equal(a.uv, b.uv)
    assert np.isnan(results[3].covariance).all()
    # A keyframe that is set anew is another one.
    aligner.set_reference(0, other.reference, None, other.depth, other.K)
    np.testing.assert_array_equal(aligner.align(0, other.target).T_10, alone.T_10)
    assert aligner.align_batch([]) == []


def test_pixels_are_copied_when_a_reference_is_set(small: Scene) -> None:
    aligner = iclk.Aligner(160, 120, "classical", "cpu")
    image = small.reference.copy()
    aligner.set_reference(0, image, small.uv, small.z, small.K)
    before = aligner.align(0, small.target)
    image[:] = 0
    # A mask needs another plan, which is given the keyframe again.
    mask = np.ones((120, 160), bool)
    mask[:40] = False
    masked = aligner.align(0, small.target, mask=mask)
    assert masked.converged and "hidden" in masked.feature_status
    assert small.error(masked.T_10) < 0.2 and before.converged


def test_what_cannot_be_aligned_is_a_status(small: Scene, device: str | None) -> None:
    flat = np.full_like(small.target, 90)
    for target, depth in ((flat, small.z), (small.target, np.zeros_like(small.z))):
        r = iclk.align(small.reference, target, small.uv, depth, small.K, device=device, model="classical")
        assert not r.converged and r.status in ("degenerate", "too_few_features", "diverged") and r.reason
        assert np.isfinite(r.T_10).all() and np.isnan(r.covariance).all()
    none = iclk.align(small.reference, small.target, [], [], small.K, device=device, model="classical")
    assert none.status == "too_few_features" and none.uv.shape == (0, 2) and none.feature_status == ()
    bad = np.array([np.nan, np.inf, -1, 0])
    aligner = iclk.Aligner(160, 120, "classical", device)
    verdicts = aligner.set_reference(0, small.reference, small.uv[:4], bad, small.K)
    assert verdicts == ["not_finite", "no_depth", "no_depth", "no_depth"]


def test_a_result_is_a_plain_value(small: Scene) -> None:
    r = iclk.align(small.reference, small.target, small.uv, small.z, small.K, device="cpu", model="classical")
    again = pickle.loads(pickle.dumps(r))
    np.testing.assert_array_equal(again.T_10, r.T_10)
    assert again.status == r.status and again.stages[0].name == "iclk" and "converged" in repr(r)
    with pytest.raises(AttributeError):
        r.status = "diverged"  # type: ignore[misc]


def test_a_learned_model_answers_where_it_is_asked(small: Scene) -> None:
    r = iclk.align(small.reference, small.target, small.uv, small.z, small.K, device="cpu", model="sd6dof-small")
    assert r.converged and r.model.startswith("sd6dof-small") and small.error(r.T_10) < 0.2
    info = iclk.model_info("sd6dof", 320, 240)
    assert info["parameters"] > 100_000 and info["width"] == 320 and info["licence"]


@pytest.mark.parametrize(
    "change, words",
    [
        ({"target": np.zeros((120, 161), np.uint8)}, "target is 161x120"),
        ({"reference": np.zeros((120, 160, 4), np.uint8)}, "H x W x 3"),
        ({"reference": np.zeros((120, 160))}, "float64"),
        ({"target": np.full((120, 160), np.nan, np.float32)}, "NaN"),
        ({"uv": np.zeros((5, 3))}, "N x 2"),
        ({"depth": np.ones(3)}, "one depth per feature"),
        ({"depth": np.ones((120, 160), np.float32)}, "depth\\[v, u\\]"),
        ({"uv": None, "depth": np.ones((120, 160), np.uint16)}, "raw / 5000"),
        ({"uv": None, "depth": np.ones((12, 16), np.float32)}, "16x12"),
        ({"uv": None, "count": 0}, "1 to 100000"),
        ({"K": np.eye(4)}, "3 x 3"),
        ({"K": np.array([[100, 1, 80], [0, 100, 60], [0, 0, 1]])}, "skew"),
        ({"K": (0, 100, 80, 60)}, "focal"),
        ({"K": (np.nan, 100, 80, 60)}, "finite"),
        ({"T_10": 2 * np.eye(4)}, "0 0 0 1"),
        ({"T_10": np.full((4, 4), np.nan)}, "finite"),
        ({"T_10": np.eye(3)}, "4 x 4"),
        ({"mask": np.ones((120, 160))}, "bool or uint8"),
        ({"mask": np.ones((12, 16), bool)}, "mask"),
        ({"sigma": np.ones(3)}, "sigma"),
        ({"levels": 40}, "level"),
        ({"robust": "hubert"}, "huber"),
        ({"search": "yes"}, "auto, on, off"),
        ({"solver": "gpu"}, "host, device, cpu"),
        ({"refine_rounds": -1}, "round"),
        ({"reference": np.zeros((0, 0), np.uint8), "target": np.zeros((0, 0), np.uint8)}, "0x0|0 x 0|empty|image"),
        ({"reference": "text"}, "shape"),
    ],
)
def test_misuse_is_a_value_error_that_says_what(small: Scene, change: dict, words: str) -> None:
    given = {
        "reference": small.reference,
        "target": small.target,
        "uv": small.uv,
        "depth": small.z,
        "K": small.K,
        "model": "classical",
        "device": "cpu",
        **change,
    }
    if "solver" in change:
        del given["device"]
    if given["uv"] is None and "depth" not in change:
        given["depth"] = small.depth
    with pytest.raises(ValueError, match=words) as caught:
        iclk.align(**given)
    assert isinstance(caught.value, iclk.Error) and caught.value.code == "invalid_argument"


def test_other_errors(small: Scene) -> None:
    with pytest.raises(iclk.Error, match="sd6dof") as caught:
        iclk.Aligner(160, 120, "no-such-model", "cpu")
    assert caught.value.code == "io" and not isinstance(caught.value, ValueError)
    with pytest.raises(TypeError, match="unknown option 'dampfing'"):
        iclk.Aligner(160, 120, dampfing="fixed")  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="levels has the wrong type: str"):
        iclk.Aligner(160, 120, levels="four")  # type: ignore[arg-type]
    with pytest.raises(iclk.Error, match="no-such-device" if VULKAN else "cpu") as caught:
        iclk.Aligner(160, 120, device="no-such-device")
    assert caught.value.code == ("no_device" if VULKAN else "no_driver")
    aligner = iclk.Aligner(160, 120, "classical", "cpu", references=2)
    with pytest.raises(ValueError, match="outside the range of the plan, 0 to 1"):
        aligner.set_reference(2, small.reference, small.uv, small.z, small.K)
    with pytest.raises(ValueError, match="slot 1 was not set"):
        aligner.align(1, small.target)
    with pytest.raises(ValueError, match="plan was made for 160x120"):
        aligner.set_reference(0, np.zeros((121, 160), np.uint8), small.uv, small.z, small.K)
    with pytest.raises(ValueError, match="positive"):
        iclk.Aligner(160, 120, "classical", "cpu", batch=0)
