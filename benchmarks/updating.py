"""Parameters from modes: published cases, an eighteen-storey frame and the IASC-ASCE building whose braces go, and a
plane frame of 1,908 coordinates.

`python3 dev.py bench updating [--starts N] [--seeds N] [--frames N]`.

- Eighteen storeys: masses, nominal and actual stiffnesses, the four modes and seven sensors of the simulated example of
  SMU (Otsuki, Lander, Dong, Wang, Advances in Structural Engineering 2021, doi 10.1177/13694332211022066; its file
  Examples/EighteenStoryStructure/Simulation/EighteenStoryStructureSim.m of
  github.com/ywang-structures/Structural-Model-Updating).  All eighteen stiffnesses are unknown.  Each start draws them
  between 0 and twice their nominal values, as there; modes are without noise.
- IASC-ASCE, phase I (Johnson, Lam, Katafygiotis, Beck, Journal of Engineering Mechanics 130, 2004): the shear building
  of four storeys, 106.60 MN/m each along x and 67.90 MN/m along y, 1 % modal damping, a force at the roof along the
  diagonal and 10 % noise, as in its case 3.  Damage pattern 1 takes all braces of the first storey: −45.2 % and
  −71.0 %.  Masses of the floors, from memory and not read again:
  3452.4, 2652.4, 2652.4, 1809.9 kg; turning, which a force through the centre
  of symmetric floors does not excite, is left out, so that 8 of its 12 coordinates remain.  The records are ours (the
  distributed program is not used): 40 s of random force up to 90 Hz at 250 samples a second, exact.
- A frame of 12 storeys and 3 bays, members of 8 beam elements each (Euler-Bernoulli, consistent masses), 1,908
  coordinates.  The stiffnesses of columns and of beams of every two storeys have a factor each, 12 in all, drawn within
  30 % of 1; eight modes at 43 sensors along x and y at the joints, 0.01 % noise of frequencies, 1 % of shapes.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import eigsh

import dashpot
from dashpot.channel import Channel, Quantity
from dashpot.data.modal_data import ModalData, independent_modes
from dashpot.data.record import Record
from dashpot.model.elements import Element, Kind
from dashpot.model.matrix_elements import block_elements
from dashpot.model.network import Model

NOMINAL = 1e5 * np.array(
    [1155, 1092, 1073, 1028, 1028, 990, 963, 938, 876, 840, 824, 788, 712, 660, 619, 562, 491, 363]
)  # N/m
ACTUAL = 1 + 0.05 * np.array([1, 1, -1, -2, 2, -3, 3, 5, -2, 4, 6, 5, -3, 1, -3, 2, 4, 4])
MASSES = np.array([208] * 11 + [206] * 6 + [202]) * 1e3 / 9.8  # kg
SENSORS, MODES = (1, 4, 7, 9, 12, 15, 18), 4

FLOORS = np.array([3452.4, 2652.4, 2652.4, 1809.9])  # kg
STOREYS = {"x": 106.60e6, "y": 67.90e6}  # N/m
BRACES = {"x": 0.452, "y": 0.710}  # of it, in the first storey
RATE, SECONDS, NOISE, DAMPING = 250.0, 40.0, 0.10, 0.01


def chain(masses: np.ndarray, stiffness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Natural frequencies, rad/s, and mass-normalised shapes (points, modes) of storeys on the ground."""
    n = len(masses)
    K = (
        np.diag(stiffness + np.append(stiffness[1:], 0))
        - np.diag(stiffness[1:], 1)
        - np.diag(stiffness[1:], -1)
    )
    size = np.sqrt(masses)
    values, vectors = np.linalg.eigh(K / np.outer(size, size))
    assert len(values) == n
    return np.sqrt(values), vectors / size[:, None]


def storeys(letter: str, masses: np.ndarray, guesses: np.ndarray | None) -> list[Element]:
    """Known masses and unknown springs of one direction."""
    points = [f"{letter}{i + 1}" for i in range(len(masses))]
    parts = [
        Element(f"m{p}", Kind.MASS, {p: 1.0}, value=float(m)) for p, m in zip(points, masses, strict=True)
    ]
    for i, point in enumerate(points):
        along = {point: 1.0, points[i - 1]: -1.0} if i else {point: 1.0}
        guess = None if guesses is None else float(guesses[i])
        parts.append(Element(f"k{point}", Kind.SPRING, along, guess=guess))
    return parts


def eighteen(starts: int) -> None:
    """Print how many of the starts end within 1 % of the truth."""
    omega, shapes = chain(MASSES, NOMINAL * ACTUAL)
    at = np.array(SENSORS) - 1
    seen = shapes[at, :MODES].T
    seen = seen / seen[np.arange(MODES), np.argmax(np.abs(seen), axis=1)][:, None]
    f = omega[:MODES] / (2 * np.pi)
    none = np.full(MODES, np.nan)
    data = independent_modes(
        tuple(f"x{k}" for k in SENSORS),
        (f, 1e-4 * f),
        (none, none),
        (seen.astype(complex), np.full(seen.shape, 1e-3)),
    )
    rng, errors, seconds = np.random.default_rng(1), [], []
    for start in range(starts):
        guesses = NOMINAL * rng.uniform(0, 2, len(NOMINAL))
        model = Model(tuple(f"x{i + 1}" for i in range(18)), (), tuple(storeys("x", MASSES, guesses)))
        begin = time.process_time()
        estimate = dashpot.identify(model, data, seed=start)
        seconds.append(time.process_time() - begin)
        errors.append(float(np.max(np.abs(estimate.values / (NOMINAL * ACTUAL) - 1))))
    inside = int(np.sum(np.array(errors) < 0.01))
    print(
        f"eighteen storeys: {inside} of {starts} starts within 1 %, largest error {100 * max(errors):.2g} %, "
        f"{np.median(seconds):.2g} s a run (most {max(seconds):.2g} s)",
        flush=True,
    )


def building(left: dict[str, float], rng: np.random.Generator) -> Record:
    """Accelerations of all floors along x and y under one diagonal force at the roof."""
    samples = round(RATE * SECONDS)
    period = 7 * samples + 13
    hz = np.fft.rfftfreq(period, 1 / RATE)
    U = (rng.normal(size=len(hz)) + 1j * rng.normal(size=len(hz))) * ((hz > 0.5) & (hz < 90))
    s = 2j * np.pi * hz[:, None]
    outputs = []
    for letter, k in STOREYS.items():
        omega, phi = chain(FLOORS, k * np.array([left[letter], 1, 1, 1]))
        q = s**2 / (s**2 + 2 * DAMPING * omega * s + omega**2) * phi[-1] / np.sqrt(2)
        outputs.append(np.fft.irfft((q @ phi.T) * U[:, None], period, axis=0)[:samples])
    y = np.concatenate(outputs, axis=1)
    y = y + NOISE * np.std(y, axis=0) * rng.standard_normal(y.shape)
    names = [f"{letter}{i}" for letter in STOREYS for i in range(1, 5)]
    channels = [Channel("f", {"f": 1.0}, Quantity.FORCE)]
    channels += [Channel(name, {name: 1.0}, Quantity.ACCELERATION) for name in names]
    return Record(
        tuple(channels), np.arange(samples) / RATE, np.column_stack([np.fft.irfft(U, period)[:samples], y])
    )


def braces(seeds: int) -> None:
    """Print the change of every storey, found from the modes of two records, and how often intervals hold it."""
    names = [f"{letter}{i}" for letter in STOREYS for i in range(1, 5)]
    parts = [part for letter in STOREYS for part in storeys(letter, FLOORS, None)]
    model = Model(tuple(names), (), tuple(parts))
    truth = np.concatenate([[1 - BRACES[letter], 1, 1, 1] for letter in STOREYS])
    rows, sds, seconds = [], [], []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        found = []
        for left in ({"x": 1.0, "y": 1.0}, {letter: 1 - gone for letter, gone in BRACES.items()}):
            record = building(left, rng)
            begin = time.process_time()
            modes = dashpot.modes(record, "f")
            data: ModalData = modes.modal_data
            # Modal damping of 1 % is no damper between storeys: frequencies and shapes alone
            data = replace(data, damping_ratio=np.full(data.modes, np.nan))
            estimate = dashpot.identify(model, data)
            seconds.append(time.process_time() - begin)
            found.append((estimate.values, np.sqrt(np.diagonal(estimate.covariance))))
            if seed == 0:
                print(f"  frequencies, Hz: {', '.join(f'{f:.3f}' for f in modes.frequency_hz)}")
        (before, sd_before), (after, sd_after) = found
        rows.append(after / before)
        sds.append(after / before * np.hypot(sd_before / before, sd_after / after))
    ratio, sd = np.array(rows), np.array(sds)
    for k, name in enumerate(names):
        change, spread = 100 * (ratio[0, k] - 1), 100 * 1.96 * sd[0, k]
        print(f"  k{name}: {change:+.2f} ± {spread:.2f} % (true {100 * (truth[k] - 1):+.1f} %)")
    z = (ratio - truth) / sd
    print(
        f"braces: 95 % intervals hold {100 * np.mean(np.abs(z) < 1.96):.1f} % of {z.size} changes, error "
        f"{np.sqrt(np.mean(z**2)):.2f} sd (rms), {np.median(seconds):.2g} s a record"
    )


STOREYS_OF_FRAME, BAYS, ELEMENTS = 12, 3, 8  # elements of a member
BAY, HEIGHT = 4.0, 3.0  # m
EA, EI, MASS = 210e9 * 8e-3, 210e9 * 1e-4, 7850.0 * 8e-3  # N, N·m², kg/m


def frame() -> tuple[list[sparse.csr_array], sparse.csr_array, list[int]]:
    """The stiffness of each group of members, the masses, and the rows of x and y at the joints above ground."""
    grid = np.arange(BAYS * ELEMENTS + 1), np.arange(STOREYS_OF_FRAME * ELEMENTS + 1)
    at = {(i, j): None for j in grid[1] for i in grid[0] if i % ELEMENTS == 0 or (j and j % ELEMENTS == 0)}
    number = {place: k for k, place in enumerate(at)}
    groups: dict[int, list[tuple[int, int, float]]] = {}
    masses: list[tuple[int, int, float]] = []
    for (i, j), k in number.items():
        ends = []
        if i % ELEMENTS == 0 and (i, j + 1) in number:
            ends.append((number[i, j + 1], HEIGHT / ELEMENTS, (0.0, 1.0), j // ELEMENTS // 2 * 2))
        if j and j % ELEMENTS == 0 and (i + 1, j) in number:
            ends.append((number[i + 1, j], BAY / ELEMENTS, (1.0, 0.0), (j - 1) // ELEMENTS // 2 * 2 + 1))
        for other, length, (c, s), group in ends:
            rows = [3 * k, 3 * k + 1, 3 * k + 2, 3 * other, 3 * other + 1, 3 * other + 2]
            turn = np.kron(np.eye(2), np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]))
            for entries, matrix in zip((groups.setdefault(group, []), masses), beam(length), strict=True):
                whole = turn.T @ matrix @ turn
                entries += [(rows[p], rows[q], whole[p, q]) for p in range(6) for q in range(6)]
    free = [3 * k + d for (_, j), k in number.items() if j for d in range(3)]
    joints = {
        3 * k + d for (i, j), k in number.items() if j and i % ELEMENTS == j % ELEMENTS == 0 for d in (0, 1)
    }

    def matrix(entries: list[tuple[int, int, float]]) -> sparse.csr_array:
        row, column, value = (np.array(part) for part in zip(*entries, strict=True))
        size = 3 * len(number)
        return sparse.csr_array(sparse.csr_array((value, (row, column)), shape=(size, size))[free][:, free])

    stiffness = [matrix(groups[group]) for group in sorted(groups)]
    return stiffness, matrix(masses), [row for row, place in enumerate(free) if place in joints]


def beam(length: float) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and consistent masses (6, 6) of an element along x: u, v and the angle of both ends."""
    a, b, h = EA / length, EI / length**3, length
    bend = b * np.array([[12, 6 * h], [6 * h, 4 * h * h]])
    far = b * np.array([[-12, 6 * h], [-6 * h, 2 * h * h]])
    other = b * np.array([[12, -6 * h], [-6 * h, 4 * h * h]])
    K, M = np.zeros((6, 6)), np.zeros((6, 6))
    K[np.ix_((0, 3), (0, 3))] = a * np.array([[1, -1], [-1, 1]])
    K[np.ix_((1, 2, 4, 5), (1, 2, 4, 5))] = np.block([[bend, far], [far.T, other]])
    M[np.ix_((0, 3), (0, 3))] = MASS * h / 6 * np.array([[2, 1], [1, 2]])
    M[np.ix_((1, 2, 4, 5), (1, 2, 4, 5))] = (
        MASS
        * h
        / 420
        * np.array(
            [
                [156, 22 * h, 54, -13 * h],
                [22 * h, 4 * h * h, 13 * h, -3 * h * h],
                [54, 13 * h, 156, -22 * h],
                [-13 * h, -3 * h * h, -22 * h, 4 * h * h],
            ]
        )
    )
    return K, M


def frames(draws: int) -> None:
    """Print how near twelve factors come, and how long it takes."""
    stiffness, masses, joints = frame()
    names = tuple(f"q{i + 1}" for i in range(masses.shape[0]))
    scores, seconds = [], []
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        true = 1 + 0.3 * rng.uniform(-1, 1, len(stiffness))
        squares, shapes = eigsh(
            sum(f * K for f, K in zip(true, stiffness, strict=True)), 8, M=masses, sigma=0
        )
        hz = np.sqrt(squares) / (2 * np.pi)
        at = np.sort(rng.choice(joints, 43, replace=False))
        seen = shapes[at].T
        seen = seen / seen[np.arange(8), np.argmax(np.abs(seen), axis=1)][:, None]
        seen = seen + 0.01 * (rng.standard_normal(seen.shape) + 1j * rng.standard_normal(seen.shape))
        measured, none = hz * (1 + 1e-4 * rng.standard_normal(8)), np.full(8, np.nan)
        data = independent_modes(
            tuple(names[k] for k in at),
            (measured, 1e-4 * hz),
            (none, none),
            (seen, np.full(seen.shape, 0.01)),
        )
        begin = time.process_time()
        parts = [e for g, K in enumerate(stiffness) for e in block_elements(f"k{g + 1}", "K", K, names)]
        parts += block_elements("mass", "M", masses, names, value=1.0)
        estimate = dashpot.identify(Model(names, (), tuple(parts)), data)
        seconds.append(time.process_time() - begin)
        scores.append((estimate.values - true) / np.sqrt(np.diagonal(estimate.covariance)))
    z = np.array(scores)
    print(
        f"frame of {len(names)} coordinates, 12 factors from 8 modes at 43 sensors: error {np.sqrt(np.mean(z**2)):.2f} "
        f"sd (rms), 95 % intervals hold {100 * np.mean(np.abs(z) < 1.96):.0f} % of {z.size}, "
        f"{np.median(seconds):.2g} s each (most {max(seconds):.2g} s)\n  {estimate.notes[0].text}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--starts", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--frames", type=int, default=5)
    options = parser.parse_args()
    if options.starts:
        eighteen(options.starts)
    if options.seeds:
        braces(options.seeds)
    if options.frames:
        frames(options.frames)


if __name__ == "__main__":
    main()
