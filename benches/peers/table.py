"""Rows of the peers' table: how each is measured, and what is compared."""

import csv
import statistics
import sys
import time

import torch

# Of each row at least this many samples, and more where they are short.
SAMPLES = 10
SECONDS = 2.0
WARM_UP = 1
COLUMNS = [
    "work", "peer", "precision", "samples", "wall_ms_best", "wall_ms", "cpu_ms_best", "cpu_ms",
    "gflop", "wall_gflops", "cpu_gflops", "guard4d_wall_percent", "guard4d_cpu_percent",
]  # fmt: skip


def wall_seconds(once):
    """Seconds by the clock on the wall."""
    start = time.perf_counter()
    once()
    return time.perf_counter() - start


def cuda_seconds(once):
    """Seconds by the clock of NVIDIA's device."""
    start, end = torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)
    start.record()
    once()
    end.record()
    torch.cuda.synchronize()
    return start.elapsed_time(end) / 1e3


def measure(once, clock):
    """Seconds by a clock and CPU seconds of each run; CPU time is of all threads, a software driver's among them."""
    for _ in range(WARM_UP):
        once()
    wall, cpu = [], []
    while len(wall) < SAMPLES or sum(wall) < SECONDS:
        start = time.process_time()
        wall.append(clock(once))
        cpu.append(time.process_time() - start)
    return wall, cpu


def row(work, peer, precision, flops, once, clock=wall_seconds):
    """One line of the table."""
    wall, cpu = measure(once, clock)
    print(f"{work}, {peer} {precision}: {1e3 * min(wall):.2f} ms", file=sys.stderr)
    times = [min(wall), statistics.median(wall), min(cpu), statistics.median(cpu)]
    return line(work, (peer, precision, len(wall)), [1e3 * t for t in times], flops)


def line(work, who, times_ms, flops):
    """A line from best and median wall and CPU milliseconds; of work that is no arithmetic, `flops` is `None`."""
    rates = [flops / 1e9, flops / 1e6 / times_ms[1], flops / 1e6 / times_ms[3]] if flops else [None] * 3
    return dict(zip(COLUMNS, [work, *who, *times_ms, *rates], strict=False))


def compare(rows):
    """What guard4d's f32 on the first driver reaches of each peer's speed, from best times, and in which order rows
    stand: work that guard4d does not do comes last and has no share.
    """
    ours = {r["work"]: r for r in rows if r["peer"] == "guard4d" and r["precision"] == "f32"}
    for r in rows:
        own = ours.get(r["work"])
        r["guard4d_wall_percent"] = 100 * r["wall_ms_best"] / own["wall_ms_best"] if own else None
        r["guard4d_cpu_percent"] = 100 * r["cpu_ms_best"] / own["cpu_ms_best"] if own else None
    works = list(dict.fromkeys([*ours, *(r["work"] for r in rows)]))
    return sorted(rows, key=lambda r: works.index(r["work"]))


def text(value):
    """A cell."""
    if value is None:
        return ""
    return f"{value:.2f}" if isinstance(value, float) else str(value)


def write(rows, path):
    """The table that programs read."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows({c: text(r[c]) for c in COLUMNS} for r in rows)


def markdown(rows):
    """The table that people read."""
    out = [
        f"| {' | '.join(c.replace('_', ' ') for c in COLUMNS)} |",
        f"| {' | '.join(['---'] * 3 + ['---:'] * (len(COLUMNS) - 3))} |",
    ]
    return "\n".join(out + [f"| {' | '.join(text(r[c]) for c in COLUMNS)} |" for r in rows])
