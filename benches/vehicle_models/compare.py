#!/usr/bin/env python3
"""Compares the vehicle simulation with the single-track and multi-body models of commonroad-vehicle-models.

See README.md beside this file. All quantities in SI units, at the centre of mass.
"""

import argparse
import csv
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from vehiclemodels.init_mb import init_mb
from vehiclemodels.init_st import init_st
from vehiclemodels.parameters_vehicle1 import parameters_vehicle1
from vehiclemodels.parameters_vehicle2 import parameters_vehicle2
from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb
from vehiclemodels.vehicle_dynamics_st import vehicle_dynamics_st

ROOT = Path(__file__).resolve().parents[2]
VEHICLES = {1: ("ford_escort", parameters_vehicle1), 2: ("bmw_320i", parameters_vehicle2)}
MANEUVERS = ["step_steer", "ramp_steer", "slalom", "brake_in_turn"]
SIGNALS = ["yaw_rate_radps", "lateral_acceleration_mps2", "speed_mps", "x_m", "y_m"]
TICK = 0.01  # s, time over which inputs are constant
STEP = 0.0005  # s, integration step
EVERY = 5  # ticks between rows of the reference


def read(path):
    with open(path, newline="") as file:
        rows = list(csv.DictReader(file))
    return {key: np.array([float(row[key]) for row in rows]) for key in rows[0]}


def simulate(dynamics, start, parameters, inputs, observe, step):
    """Signals at each tick; `observe` computes them from a state and its derivative."""
    state, out = np.array(start, dtype=float), []
    steps = round(TICK / step)

    def f(x, u):
        return np.array(dynamics(list(x), list(u), parameters))

    for u in inputs:
        out.append(observe(state, f(state, u)))
        for _ in range(steps):
            k1 = f(state, u)
            k2 = f(state + 0.5 * step * k1, u)
            k3 = f(state + 0.5 * step * k2, u)
            k4 = f(state + step * k3, u)
            state = state + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return {key: np.array(column) for key, column in zip(SIGNALS, zip(*out))}


def observe_st(x, dx):
    speed, slip = x[3], x[6]
    lateral = dx[3] * np.sin(slip) + speed * (dx[4] + dx[6]) * np.cos(slip)
    return x[5], lateral, speed * np.cos(slip), x[0], x[1]


def observe_mb(x, dx):
    # velocities are in the body's frame: x4 forward, x11 to the left
    return x[5], dx[10] + x[5] * x[3], x[3], x[0], x[1]


def reference(parameters, sim, step=STEP):
    """Motion of the reference models under the simulation's inputs."""
    core = [0.0, 0.0, 0.0, sim["speed_mps"][0], 0.0, 0.0, 0.0]
    inputs = list(zip(sim["steering_rate_radps"], sim["acceleration_mps2"]))
    return {
        "st": simulate(vehicle_dynamics_st, init_st(core), parameters, inputs, observe_st, step),
        "mb": simulate(vehicle_dynamics_mb, init_mb(core, parameters), parameters, inputs, observe_mb, step),
    }


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def share(a, b, key):
    """RMS of the difference over the RMS of the second signal, percent."""
    return 100.0 * rms(a[key] - b[key]) / rms(b[key])


def largest_distance(a, b):
    return float(np.max(np.hypot(a["x_m"] - b["x_m"], a["y_m"] - b["y_m"])))


COLUMNS = [
    "vehicle", "maneuver", "yaw rate: simulation to ST, %", "simulation to MB, %", "ST to MB, %",
    "lateral acceleration: simulation to ST, %", "simulation to MB, %", "ST to MB, %",
    "largest distance: simulation to ST, m", "simulation to MB, m", "ST to MB, m", "distance driven, m",
]


def row_of(name, maneuver, sim, st, mb):
    pairs = [(sim, st), (sim, mb), (st, mb)]
    distance = float(np.sum(np.hypot(np.diff(sim["x_m"]), np.diff(sim["y_m"]))))
    shares = [share(a, b, key) for key in SIGNALS[:2] for a, b in pairs]
    values = shares + [largest_distance(a, b) for a, b in pairs] + [distance]
    return [name, maneuver.replace("_", " ")] + [f"{value:.2f}" for value in values]


def write_table(folder, rows):
    with open(folder / "comparison.csv", "w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([COLUMNS, *rows])


def write_reference(path, runs):
    with open(path, "w", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        keys = [f"{model}_{key}" for model in ("st", "mb") for key in ("yaw_rate", "lateral_acceleration", "x", "y")]
        out.writerow(["vehicle", "maneuver", "tick", *keys])
        for (number, maneuver), (sim, models) in runs.items():
            for tick in range(0, len(sim["time_s"]), EVERY):
                columns = [("yaw_rate_radps", 5), ("lateral_acceleration_mps2", 4), ("x_m", 3), ("y_m", 3)]
                values = [f"{models[m][key][tick] + 0.0:.{digits}f}" for m in ("st", "mb") for key, digits in columns]
                out.writerow([number, maneuver, tick, *values])


# Pictures.

LINES = [("simulation", "#1a1a1a", "1.6", ""), ("ST", "#0072b2", "1.4", "6 3"), ("MB", "#d55e00", "1.4", "2 2")]
PANELS = [("yaw_rate_radps", "yaw rate, rad/s"), ("lateral_acceleration_mps2", "lateral acceleration, m/s²")]
WIDTH, HEIGHT, LEFT, TOP, GAP = 235, 150, 62, 44, 46


def ticks(low, high):
    """Round numbers that cover the range, four to eight of them."""
    raw = (high - low) / 5.0
    scale = 10.0 ** np.floor(np.log10(raw))
    step = next(m * scale for m in (1, 2, 5, 10) if m * scale >= raw)
    return np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step


def number(value):
    return f"{round(value, 9) + 0.0:.4g}".replace("-", "−")


def panel(x, y, time, series, title, label):
    """One pair of axes with the lines of all models."""
    low = min(float(np.min(values)) for values in series)
    high = max(float(np.max(values)) for values in series)
    low, high = low - 0.06 * (high - low), high + 0.06 * (high - low)
    px = lambda t: x + (t - time[0]) / (time[-1] - time[0]) * WIDTH
    py = lambda v: y + HEIGHT - (v - low) / (high - low) * HEIGHT
    out = [f'<rect x="{x}" y="{y}" width="{WIDTH}" height="{HEIGHT}" fill="none" stroke="#999"/>']
    for v in ticks(low, high):
        out.append(f'<path d="M{x} {py(v):.1f}h{WIDTH}" stroke="#e4e4e4"/>')
        out.append(f'<text x="{x - 5}" y="{py(v) + 3.5:.1f}" text-anchor="end">{number(v)}</text>')
    for t in range(0, int(time[-1]) + 1, 2):
        out.append(f'<text x="{px(t):.1f}" y="{y + HEIGHT + 13}" text-anchor="middle">{t}</text>')
    for values, (_, colour, width, dashes) in zip(series, LINES):
        points = " ".join(f"{px(t):.1f},{py(v):.1f}" for t, v in zip(time[::3], values[::3]))
        dash = f' stroke-dasharray="{dashes}"' if dashes else ""
        out.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="{width}"{dash}/>')
    if title:
        out.append(f'<text x="{x + WIDTH / 2}" y="{y - 8}" text-anchor="middle" font-weight="bold">{title}</text>')
    if label:
        middle = y + HEIGHT / 2
        out.append(f'<text transform="translate({x - 46} {middle}) rotate(-90)" text-anchor="middle">{label}</text>')
    return out


def picture(path, name, runs):
    total_width = LEFT + len(MANEUVERS) * (WIDTH + GAP)
    total_height = TOP + 2 * (HEIGHT + GAP) + 20
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {total_width} {total_height}" '
        'font-family="sans-serif" font-size="11" fill="#333">',
        f"<title>{name}: the simulation and CommonRoad's single-track (ST) and multi-body (MB) models</title>",
        f'<rect width="{total_width}" height="{total_height}" fill="white"/>',
    ]
    for column, maneuver in enumerate(MANEUVERS):
        sim, models = runs[maneuver]
        for line, (key, label) in enumerate(PANELS):
            series = [sim[key], models["st"][key], models["mb"][key]]
            x, y = LEFT + column * (WIDTH + GAP), TOP + line * (HEIGHT + GAP)
            title = maneuver.replace("_", " ") if line == 0 else ""
            out += panel(x, y, sim["time_s"], series, title, label if column == 0 else "")
    bottom = total_height - 12
    for i, (label, colour, width, dashes) in enumerate(LINES):
        x = LEFT + 110 * i
        dash = f' stroke-dasharray="{dashes}"' if dashes else ""
        out.append(f'<path d="M{x} {bottom - 4}h30" stroke="{colour}" stroke-width="{width}"{dash}/>')
        out.append(f'<text x="{x + 36}" y="{bottom}">{label}</text>')
    out.append(f'<text x="{total_width - GAP}" y="{bottom}" text-anchor="end">{name}; time in s</text></svg>\n')
    path.write_text("\n".join(out))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--maneuvers", default=ROOT / "target/release/examples/maneuvers", type=Path,
                        help="the built example")
    parser.add_argument("--check-step", action="store_true",
                        help="only print the effect of halving the integration step")
    arguments = parser.parse_args()
    runs = {}
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([arguments.maneuvers, folder], check=True, stdout=subprocess.DEVNULL)
        for number_, (name, parameters) in VEHICLES.items():
            for maneuver in MANEUVERS:
                sim = read(Path(folder) / f"{number_}.{maneuver}.csv")
                runs[number_, maneuver] = (sim, reference(parameters(), sim))
                if arguments.check_step:
                    finer = reference(parameters(), sim, 0.5 * STEP)
                    models = runs[number_, maneuver][1]
                    change = max(np.max(np.abs(models[m]["yaw_rate_radps"] - finer[m]["yaw_rate_radps"])) for m in finer)
                    print(f"{name} {maneuver}: {change:.1e} rad/s")
    if arguments.check_step:
        return
    docs = ROOT / "docs/physics"
    docs.mkdir(parents=True, exist_ok=True)
    rows = [row_of(VEHICLES[v][0], m, sim, models["st"], models["mb"]) for (v, m), (sim, models) in runs.items()]
    write_table(docs, rows)
    write_reference(Path(__file__).parent / "reference.csv", runs)
    for number_, (name, _) in VEHICLES.items():
        picture(docs / f"{name}.svg", name, {m: runs[number_, m] for m in MANEUVERS})
    print("\n".join("| " + " | ".join(row) + " |" for row in [COLUMNS, *rows]))


if __name__ == "__main__":
    main()
