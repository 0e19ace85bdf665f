"""Study files: TOML that says which rigs, tests, noises and methods to compare by Monte Carlo.

    study = read_study("study.toml")

    name = "How much noise"                     draws = 1000       seed = 1       methods = ["iv", "oiv"]
    [rigs.paper]                                file = "rig.toml"  values = { m1 = 3.0, c1 = "30 N·s/m" }
    [frequencies]                               few = [1, 2, 5]    range = "0.5:25/40"
    [unknowns]                                  two = ["m1", "c1"]
    [[grid]]                                    noise = ["1 %", 0.1]  samples = [56]

Whatever is wrong with a file is a UsageError with all its problems, each at `study.toml:8: grid[0].noise`.
"""

from dashpot.study.studyfile.reader import parse_study, read_study

__all__ = ["parse_study", "read_study"]
