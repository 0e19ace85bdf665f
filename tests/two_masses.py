"""Rigs of two masses on a shaken base, which many tests share."""

RIG = """\
name = "Two masses on a shaken base"
coordinates = ["x1", "x2"]
[inputs]
u = { kind = "displacement" }
[masses]
m1 = { at = "x1" }
m2 = { at = "x2", value = 2.7 }
[springs]
k1 = { between = ["x1", "x2"], value = 4600 }
k2 = { between = ["x2", "u"], value = 4600 }
[dampers]
c1 = { between = ["x1", "x2"] }
c2 = { between = ["x2", "u"] }
[channels]
x1 = { of = "x1", unit = "mm", noise = 0.02 }
x2 = { of = "x2", unit = "mm", noise = 0.02 }
u = { of = "u", unit = "mm" }
"""
VALUES = {"m1": 3.0, "c1": 20.0, "c2": 30.0}
