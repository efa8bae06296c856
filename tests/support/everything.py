"""A scenario with every key that there is, as a file and as the dive that it means."""

import math

from usbldr.filters.models.noise import Contamination, Gaussian, Mixture, StudentT
from usbldr.filters.models.parameters import ProcessNoise, Start
from usbldr.filters.simulation.scenario import (
    Accuracy,
    AcousticHead,
    Compass,
    CorrelatedError,
    Dvl,
    Gps,
    Leg,
    Multipath,
    Outliers,
    Scenario,
    Timing,
    Usbl,
)

EVERYTHING = """
schema = 1
about = "every key that there is"
duration_s = 60.0

[vehicle]
east_m = 1.0
north_m = 2.0
depth_m = 3.0
heading_deg = 90.0

[[leg]]
duration_s = 30.0
forward_mps = 1.5

[[leg]]
duration_s = 30.0
starboard_mps = 0.1
forward_mps = 1.0
turn_rate_dps = 6.0

[current]
east_mps = 0.2
north_mps = -0.1

[dvl]
rate_hz = 5.0
latency_s = 0.1
delay_s = 0.2
delay_spread_s = 0.3
jitter_s = 0.04
clock_offset_s = -0.5
dropout_share = 0.06
silences_s = [[7.0, 8.0]]
sd_mps = 0.02
noise = { kind = "student-t", dof = 5.0 }
scale_error = 0.01
mount_deg = 2.0
bias_mps = [0.03, 0.04]
lever_arm_m = [0.5, 0.6, -0.7]
water_track_s = [[10.0, 20.0]]
correlated_sd_mps = 0.005
correlated_time_s = 30.0
outlier_share = 0.1
outlier_mps = [1.0, 2.0]
assumed_sd_mps = 0.05
assumed_noise = { kind = "gaussian" }

[compass]
rate_hz = 10.0
sd_deg = 0.5
noise = { kind = "mixture" }
bias_deg = 3.0
deviation_sin_deg = 1.0
deviation_cos_deg = 2.0
correlated_sd_deg = 0.2
outlier_share = 0.2
outlier_deg = [20.0, 30.0]
assumed_sd_deg = 0.6
assumed_noise = { kind = "contamination", share = 0.1, sd_deg = 20.0, per = "scalar" }

[usbl]
rate_hz = 1.0
accuracy = { sd_m = 0.2, sd_rel = 0.01, bearing_sd_deg = 2.0 }
noise = { kind = "contamination", share = 0.2, sd_m = 5.0 }
head = { east_m = 100.0, north_m = -50.0, depth_m = 4.0 }
inverted = true
scale_error = -0.002
mount_deg = 1.0
bias_m = [0.1, 0.2]
lever_arm_m = [0.0, -2.0, 1.0]
correlated_sd_m = 0.4
outlier_share = 0.3
outlier_m = [3.0, 4.0]
assumed_accuracy = { sd_m = 1.0 }
assumed_noise = { kind = "gaussian", per = "record" }

[usbl.multipath]
offset_m = [5.0, 6.0]
scatter_m = 0.7
share = 0.8
clusters_s = [[1.0, 2.0]]
every_s = 100.0
lasts_s = 10.0

[gps]
rate_hz = 1.0
sd_m = 0.01
noise = { kind = "mixture", share = 0.1 }
bias_m = [0.5, 0.25]
lever_arm_m = [1.0, 2.0, 3.0]
correlated_sd_m = 0.3
outlier_share = 0.4
assumed_sd_m = 0.02

[process]
position_m = 0.1
heading_deg = 1.0
velocity_mps = 0.2
turn_rate_dps = 2.0
uncalibrated_m = 0.3

[start]
east_m = 1.0
north_m = 2.0
sd_m = 0.5
"""

deg = math.radians
SCENARIO = Scenario(
    name="everything", about="every key that there is", duration_s=60.0,
    legs=(Leg(30.0, 0.0, 1.5, 0.0), Leg(30.0, 0.1, 1.0, -deg(6.0))),
    dvl=Dvl(5.0, 0.02, StudentT(5.0), 0.01, -deg(2.0), (0.03, 0.04), (0.5, 0.6, -0.7), ((10.0, 20.0),),
            CorrelatedError(0.005, 30.0), Outliers(0.1, 1.0, 2.0),
            Timing(0.1, 0.2, 0.3, 0.04, -0.5, 0.06, ((7.0, 8.0),)), 0.05, Gaussian()),
    compass=Compass(10.0, deg(0.5), Mixture(), -deg(3.0), (deg(1.0), -deg(2.0)), CorrelatedError(deg(0.2), 60.0),
                    Outliers(0.2, deg(20.0), deg(30.0)), Timing(), deg(0.6),
                    Contamination(0.1, deg(20.0), per_scalar=True)),
    usbl=Usbl(1.0, Accuracy(0.2, 0.01, deg(2.0)), Contamination(0.2, 5.0), AcousticHead(100.0, -50.0, 4.0), True,
              -0.002, -deg(1.0), (0.1, 0.2), (0.0, -2.0, 1.0), CorrelatedError(0.4, 60.0), Outliers(0.3, 3.0, 4.0),
              Multipath(5.0, 6.0, 0.7, 0.8, ((1.0, 2.0),), 100.0, 10.0), Timing(), Accuracy(1.0),
              Gaussian(per_scalar=False)),
    gps=Gps(1.0, 0.01, Mixture(0.1), (1.0, 2.0, 3.0), (0.5, 0.25), CorrelatedError(0.3, 60.0),
            Outliers(0.4, 5.0, 40.0), Timing(), 0.02),
    yaw_rad=-deg(90.0), east_m=1.0, north_m=2.0, depth_m=3.0, current_mps=(0.2, -0.1),
    process=ProcessNoise(0.1, deg(1.0), 0.2, deg(2.0), 0.3), start=Start(1.0, 2.0, 0.5),
)  # fmt: skip
