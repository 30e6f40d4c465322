"""What nodes of a network gain from talking: rounds, rules of the novelty, faults; linear, then PMHT in clutter.

First the linear position variant of the 50-node network of Garcia-Fernandez and Battistelli (one target, ten sensing
nodes, T = 2 s, sigma_Q = 4, R = 100^2 I, 50 steps): root mean square position error over nodes, runs and steps 11 to
50. The published places and links are a data file of others; ours has the same counts and the same second eigenvalue
(`jink.envs.networks.consensus_network`), so that rows agree where mixing over the whole network decides (L >= 3) and
not where the next neighbours do (L = 1).

Then three targets in clutter, distributed against one sensor and against a centre that has every detection.

python benchmarks/consensus.py [--runs 60] [--scenes 10]
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.table import Table

from jink.envs.networks import Network, consensus_network, geometric, metropolis_weights, second_eigenvalue
from jink.envs.scene_library import get_scene
from jink.envs.scenery.scene_data import SceneData
from jink.envs.scenery.scene_scans import scene_scans
from jink.envs.scenes import Scene, simulate_scene
from jink.estimators.metrics import disagreement, gospa, identities
from jink.estimators.motions.cartesian import constant_velocity
from jink.estimators.multitarget.consensus import RULES, Consensus
from jink.estimators.multitarget.distributed import DistributedPmht
from jink.estimators.multitarget.faults import Faults
from jink.estimators.multitarget.information import (
    Information,
    consensus_update,
    from_moments,
    predict_information,
    to_moments,
)
from jink.estimators.multitarget.pmht import KnownTracks, Pmht

ROUNDS = (1, 3, 5, 10, 20)
PUBLISHED = {
    "b": (76.8, 63.2, 59.3, 54.5, 50.8),
    "N": (82.5, 65.4, 59.0, 50.6, 43.1),
    "1": (98.2, 88.6, 86.5, 84.4, 83.0),
}
CENTRE = 34.4
CUTOFF = 300.0
STEPS, DT = 50, 2.0
A = np.kron(np.eye(2), [[1.0, DT], [0.0, 1.0]])
Q = 16.0 * np.kron(np.eye(2), [[DT**3 / 3, DT**2 / 2], [DT**2 / 2, DT]])
H = np.kron(np.eye(2), [[1.0, 0.0]])
R = 100.0**2 * np.eye(2)
MEAN = np.array([2000.0, 15.0, 4000.0, 5.0])
COV = np.diag([1500.0**2, 4.0, 1500.0**2, 4.0])
COV[0, 2] = COV[2, 0] = 0.6 * 1500.0**2


def fly(runs: int, sensors: int) -> tuple[np.ndarray, np.ndarray]:
    """States (runs, steps, 4) and measurements (runs, steps, sensors, 2)."""
    rng = np.random.default_rng(5)
    x = MEAN + rng.standard_normal((runs, 4)) @ np.linalg.cholesky(COV).T
    states = np.empty((runs, STEPS, 4))
    for k in range(STEPS):
        if k:
            x = x @ A.T + rng.standard_normal((runs, 4)) @ np.linalg.cholesky(Q).T
        states[:, k] = x
    return states, states[:, :, None] @ H.T + 100.0 * rng.standard_normal((runs, STEPS, sensors, 2))


def filter_nodes(
    states: np.ndarray, seen: np.ndarray, sensing: tuple[int, ...], network: Consensus
) -> tuple[float, float, float]:
    """Position error, NEES and root of the disagreement, each over nodes, runs and steps 11 to 50."""
    runs = len(states)
    inverse = np.linalg.inv(R)
    pair = from_moments(np.tile(MEAN, (network.nodes, runs, 1)), COV)
    errors, nees, apart = [], [], []
    for k in range(STEPS):
        exchange = network.exchange(DT * k, k)
        holds = np.zeros((network.nodes, runs))
        novelty = Information(np.zeros_like(pair.vector), np.zeros_like(pair.matrix))
        for index, node in enumerate(sensing):
            if exchange.alive[node]:
                holds[node] = 1.0
                novelty.vector[node], novelty.matrix[node] = seen[:, k, index] @ inverse @ H, H.T @ inverse @ H
        pair = consensus_update(pair, novelty, holds, exchange, network.rule)
        mean, cov = to_moments(pair)
        if k >= 10:
            off = mean - states[:, k]
            errors.append((off[..., [0, 2]] ** 2).sum(axis=-1))
            nees.append(np.einsum("nri,nrij,nrj->nr", off, pair.matrix, off))
            apart.append(disagreement(mean[..., [0, 2]]))
        pair = predict_information(pair, A, Q)
    return float(np.sqrt(np.mean(errors))), float(np.mean(nees)), float(np.sqrt(np.mean(apart)))


def linear_table(runs: int, console: Console) -> None:
    network = consensus_network()
    weights = metropolis_weights(network)
    states, seen = fly(runs, len(network.sensing))
    everybody = Consensus(np.full((10, 10), 0.1), 1, "N")
    centre = filter_nodes(states, seen, tuple(range(10)), everybody)[0]
    table = Table(
        title=f"50 nodes, lambda_2 = {second_eigenvalue(weights):.5f}, {runs} runs; position RMS in m (published)"
        f"; centralised {centre:.1f} ({CENTRE})"
    )
    table.add_column("omega")
    for rounds in ROUNDS:
        table.add_column(f"L = {rounds}", justify="right")
    table.add_column("NEES, L = 10 (4 = consistent)", justify="right")
    table.add_column("nodes apart, L = 10", justify="right")
    for rule in RULES:
        cells, extra = [], ("", "")
        for index, rounds in enumerate(ROUNDS):
            error, nees, apart = filter_nodes(states, seen, network.sensing, Consensus(weights, rounds, rule))
            known = f" ({PUBLISHED[rule][index]:.1f})" if rule in PUBLISHED else ""
            cells.append(f"{error:.1f}{known}")
            if rounds == 10:
                extra = f"{nees:.2f}", f"{apart:.1f} m"
        table.add_row(rule, *cells, *extra)
    console.print(table)
    table = Table(title="The same with faults, L = 10")
    for name in ("faults", "omega", "RMS", "NEES", "nodes apart"):
        table.add_column(name)
    for name, faults in (
        ("none", Faults()),
        ("30 % of messages lost", Faults(message_loss=0.3)),
        ("half of the links down at a time", Faults(link_failure=0.5)),
        ("node 8, a sensor, dead 20 s to 60 s", Faults(dead=((8, 20.0, 60.0),))),
        ("three sensing nodes 3 rounds late", Faults(delays=((1, 3), (8, 3), (10, 3)))),
    ):
        for rule in ("b", "N", "safe"):
            error, nees, apart = filter_nodes(states, seen, network.sensing, Consensus(weights, 10, rule, faults))
            table.add_row(name, rule, f"{error:.1f} m", f"{nees:.2f}", f"{apart:.1f} m")
    console.print(table)


def three_targets(nodes: int = 15) -> Scene:
    """The published scene, seen by five radars like its own on a network of 15 nodes."""
    scene = get_scene("three-targets-v0")
    network = geometric(nodes, 16_000.0, 40_000.0, seed=4, sensing=range(0, nodes, 3))
    # The square lies around the paths: x -17 to 23 km, y -18 to 22 km.
    places = tuple((x - 17_000.0, y - 18_000.0) for x, y in network.positions)
    network = Network(places, network.links, network.sensing)
    radar = scene.sensors[0]
    wide = replace(radar.region, range_max=50_000.0)
    clutter = 1e-4 * wide.polar_area
    sensors = tuple(replace(radar, place=places[node], region=wide, clutter=clutter) for node in network.sensing)
    return replace(scene, id="three-targets-network-v0", sensors=sensors, network=network)


def known_tracks(data: SceneData, seed: int) -> KnownTracks:
    """Where a start by other means would put the targets: 100 m and 20 m/s off, one sigma."""
    rng = np.random.default_rng((seed, 6))
    truth = np.hstack([data.truth.position[:, 0], data.truth.velocity[:, 0]])
    sigma = np.array([100.0, 100.0, 20.0, 20.0])
    return KnownTracks(truth + sigma * rng.standard_normal(truth.shape), np.diag(sigma**2), float(data.times[0]))


def tracked_table(runs: int, console: Console) -> None:
    scene = three_targets()
    assert scene.network is not None
    weights = metropolis_weights(scene.network)
    motion = constant_velocity(2, acceleration_density=60.0)
    sensing = scene.network.sensing
    network = Consensus(weights, 10, "safe")
    alone = Pmht(motion, initiation=None)
    v1 = DistributedPmht(motion, network, sensing)
    v2 = replace(v1, order="V2", iterations=3)
    lossy = replace(network, faults=Faults(message_loss=0.3))
    wounded = replace(network, faults=Faults(dead=((sensing[1], 100.0, 300.0),)))
    trackers = {
        "centralised": alone,
        "centralised, 3 times anew": DistributedPmht.centralised(motion, len(sensing), exchanged=3, iterations=3),
        **{f"one sensor, node {node}": DistributedPmht.centralised(motion, len(sensing)) for node in sensing},
        "V1, b": replace(v1, consensus=replace(network, rule="b")),
        "V1, N": replace(v1, consensus=replace(network, rule="N")),
        "V1, safe": v1,
        "V2, safe": v2,
        "V2, safe, 3 times sent anew": replace(v2, exchanged=3),
        "V1, safe, 30 % of messages lost": replace(v1, consensus=lossy),
        "V1, safe, a sensing node dead 100 s to 300 s": replace(v1, consensus=wounded),
    }
    rows: dict[str, list[tuple[float, ...]]] = {name: [] for name in trackers}
    # The acceleration density was chosen on seeds 0 to 7, for all trackers alike.
    for seed in range(100, 100 + runs):
        data = simulate_scene(scene, seed)
        scans, known = scene_scans(data), known_tracks(data, seed)
        times, first = np.unique(data.times, return_index=True)
        truth = data.truth.position[:, first]
        for name, tracker in trackers.items():
            begin = time.perf_counter()
            own = scans.of_sensors([sensing.index(int(name.split()[-1]))]) if ", node " in name else scans
            if isinstance(tracker, DistributedPmht):
                found = tracker.run(own, known)
                nodes, kilobytes = found.position, found.sent_bytes.mean() / 1e3
            else:
                _, paths = tracker.run(own, known).sets()
                # The last scan of each time has all of them behind it.
                nodes, kilobytes = paths[None, :, np.append(np.diff(own.times) > 0, True)], 0.0
            took = (time.perf_counter() - begin) / len(times)
            sets = [gospa(path[:, 5:], truth[:, 5:], CUTOFF) for path in nodes]
            kept = [identities(path, truth, CUTOFF) for path in nodes]
            rows[name].append(
                (
                    np.mean([one.distance.mean() for one in sets]),
                    np.sqrt(np.mean([one.localisation.sum() / one.pairs.sum() for one in sets])),
                    np.mean([one.missed_count.mean() for one in sets]),
                    np.mean([one.switches.sum() for one in kept]),
                    np.mean([one.lost.mean() for one in kept]),
                    np.sqrt(disagreement(nodes[:, :, 5:]).mean()),
                    kilobytes,
                    1e3 * took,
                )
            )
    table = Table(
        title=f"Published three targets, 5 radars on {len(weights)} nodes (second eigenvalue "
        f"{second_eigenvalue(weights):.3f}), L = 10, {runs} runs; GOSPA c = {CUTOFF:.0f} m, p = 2"
    )
    heads = (
        "tracker",
        "GOSPA",
        "/ centralised",
        "located to",
        "missed",
        "switches",
        "lost",
        "nodes apart",
        "kB a scan",
    )
    for head in (*heads, "ms a scan"):
        table.add_column(head, justify="left" if head == "tracker" else "right")
    base = np.mean(rows["centralised"], axis=0)[0]
    for name, values in rows.items():
        mean = np.mean(values, axis=0)
        table.add_row(
            name, f"{mean[0]:.1f}", f"{mean[0] / base:.2f}", f"{mean[1]:.1f}", f"{mean[2]:.2f}", f"{mean[3]:.1f}",
            f"{mean[4]:.0%}", f"{mean[5]:.1f}", f"{mean[6]:.0f}", f"{mean[7]:.1f}",
        )  # fmt: skip
    console.print(table)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=60, help="of the linear table")
    parser.add_argument("--scenes", type=int, default=10, help="runs of the scene in clutter")
    options = parser.parse_args()
    console = Console(width=160)
    linear_table(options.runs, console)
    tracked_table(options.scenes, console)
