"""Millions of pairs on Ray: `python -m iclk.ray MANIFEST --out DIR` (see `--help`), or a step of your own Ray Dataset.

    import iclk.ray, ray
    pairs = ray.data.read_parquet("pairs/")     # columns: the keys of a manifest of `iclk batch`; images as paths or bytes
    results = iclk.ray.align(pairs, camera="517.3,516.5,318.6,255.3", depth_scale=5000, workers=4)
    results.write_parquet("results/")

Needs ``iclk[ray]``: Ray, PyArrow, OpenCV (which decodes the images, as it does for `iclk batch`) and PyYAML.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ._settings import Settings

if TYPE_CHECKING:
    from ray.data import Dataset

__all__ = ["Settings", "align", "locate"]


def align(
    pairs: Dataset,
    *,
    workers: int = 1,
    cpus: float = 1,
    gpus: float = 0,
    batch_size: int = 64,
    camera: str = "",
    distortion: str = "",
    depth_scale: float = 0,
    depth_sigma: str = "auto",
    mask: str = "",
    detector: str = "shi-tomasi",
    count: int = 200,
    with_features: bool = False,
    model: str = "auto",
    device: str = "",
    batch: int = 0,
    threads: int = 0,
    max_pixels: int = 8192 * 8192,
    **options: Any,
) -> Dataset:
    """Returns one row per pair, with the results of `iclk batch`, bit for bit. Lazy, as all of Ray Data.

    pairs: columns with the names of a manifest's keys (`iclk batch --help`): reference and target, with depth or features;
    image and feature files as paths, or as the bytes of the files. workers: processes, each with ``cpus`` and ``gpus`` of
    Ray's resources (0.5: two share a GPU) and one aligner. batch_size: rows per task. batch: pairs that are aligned together;
    default: 16, fewer if the memory does not suffice. threads: for decoding; default: one per CPU. Other arguments: options of
    `iclk batch` and ``iclk.Options``.

    A row has id, status, reason, T_10 (16 numbers), covariance (36), ... (``iclk.ray._worker.SCHEMA``). A pair that cannot be
    read has status "error" and a reason. If the device of a worker fails, the worker ends and Ray starts another one.
    """
    from ._worker import PairWorker

    settings = Settings(
        camera, distortion, depth_scale, depth_sigma, mask, detector, count, with_features, model, options, device, batch,
        threads, max_pixels,
    )  # fmt: skip
    return pairs.map_batches(
        PairWorker,
        fn_constructor_args=(settings, cpus),
        batch_size=batch_size,
        batch_format="pyarrow",
        concurrency=workers,
        num_cpus=cpus,
        num_gpus=gpus,
    )


def locate(
    pictures: Dataset,
    *,
    ortho: str,
    elevation: str,
    camera: str,
    distortion: str = "",
    sigma: tuple[float, float] = (10.0, 5.0),
    height_sigma: float | None = None,
    heading_sigma: float | None = None,
    workers: int = 1,
    cpus: float = 1,
    gpus: float = 0,
    batch_size: int = 16,
    model: str = "auto",
    device: str = "",
    max_pixels: int = 8192 * 8192,
) -> Dataset:
    """Returns one row per picture, with the results of ``iclk.Map.locate``. Lazy, as all of Ray Data.

    pictures: columns image (path or bytes of the file), T_WC (approximate pose, 16 numbers row by row) and, optionally, id.
    ortho, elevation: GeoTIFFs that every worker reads with rasterio and keeps in memory. camera, distortion: as for
    `iclk locate`. sigma, height_sigma, heading_sigma: as for ``iclk.Map.locate``. workers, cpus, gpus, batch_size: as for
    ``align``.

    A row has id, status, reason, T_WC, covariance, inliers, sigma and model (``iclk.ray._locate.SCHEMA``). A picture that
    cannot be read has status "error" and a reason.
    """
    from ._locate import LocateSettings, LocateWorker

    settings = LocateSettings(
        ortho, elevation, camera, distortion, sigma, height_sigma, heading_sigma, model, device, max_pixels
    )
    return pictures.map_batches(
        LocateWorker,
        fn_constructor_args=(settings,),
        batch_size=batch_size,
        batch_format="pyarrow",
        concurrency=workers,
        num_cpus=cpus,
        num_gpus=gpus,
    )
