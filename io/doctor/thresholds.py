"""Beyond what the doctor reports a finding, in one value. The unit is in the name, or in brackets."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Thresholds:
    """The thresholds of every check; "sigmas" are standard deviations of what the check estimates."""

    # Axes, heading sense and map frame, by what is left between dead reckoning and fixes
    clearly_better_ratio: float = 0.8  # of the RMS residual: less is left by an interpretation that replaces another
    fitting_sigmas: float = 5.0  # of a fix's white noise: if the best leaves more, gross_residual_ratio decides
    max_rival_residual: float = 10.0  # [-] of the best one's: no sensor error bends a track so far from its fixes
    min_gps_spread_m: float = 3.0  # GPS that moves less is no evidence of the map's handedness
    gps_mirror_ratio: float = 0.5  # of two distances of the track from GPS: one must be this much smaller to decide
    min_gravity_mps2: float = 5.0  # [m/s^2] half of gravity: less along z is a tilted or broken accelerometer
    fix_depth_tolerance: float = 0.5  # of the depth: a z of the fixes so near to it, up or down, is a depth

    # Sensor errors that the log has evidence for
    significance_sigmas: float = 4.0  # of a latency beyond what the arrival of fixes allows: chance is below 1e-4
    min_offset_deg: float = 3.0  # a smaller turn between DVL and heading is within a compass's own error
    offset_sigmas: float = 2.0  # of that turn, whose sd comes from leaving out stretches and is itself large
    min_bias_deg: float = 2.0  # of a turn that the log has evidence for: a compensated compass deviates by less
    max_offset_sd_deg: float = 10.0  # a turn that is known no better is not reported at all
    gross_sigmas: float = 6.0  # of the scatter of all fixes: a normal error is as large once in 10^8 fixes
    min_outlier_m: float = 3.0  # no nearer fix is called an outlier, however small the others' scatter
    chance: float = 1e-4  # that heavy-tailed noise without gross errors has as many fixes as far out
    noise_ratio: float = 1.5  # of the fixes' sd to the stated one, or the inverse: NEES is then wrong by more than 2

    # Gross configuration errors, which are taken off before all else
    gross_residual_ratio: float = 0.5  # of the residual: more must vanish before another clock or unit is reported
    min_clock_step_s: float = 1.0  # a shorter step moves a vehicle by less than its fixes scatter
    clock_step_residual_ratio: float = 0.7  # half of the squared residual must vanish before a clock step is reported
    max_clock_offset_s: float = 60.0  # the search ends here: beyond, too few fixes overlap the dead reckoning
    max_far_offset_s: float = 1800.0  # of a second search; hours are a time zone, and such sensors do not overlap
    far_offset_step_s: float = 4.0  # of that search: the fit of the latency covers the rest
    min_far_residual_m: float = 10.0  # a clock that is off by more than a minute moves a vehicle by more
    far_residual_ratio: float = 0.25  # of the same fixes' residual: among so many offsets half may vanish by chance
    clock_offset_step_s: float = 2.0  # of that search; the fit of the latency covers the rest
    min_clock_offset_s: float = 4.0  # an acoustic delay and its processing explain less
    leap_second_tolerance_s: float = 1.5  # an offset so near to GPS time minus UTC is probably that
    displacement_s: float = 60.0  # long enough for a vehicle to go further than its fixes scatter
    min_displacements: int = 10  # fewer give no median
    unlike_share: float = 0.5  # of the squared displacement: tracks that differ by more do not move together
    sound_share: float = 0.25  # of the displacements: as many have two good fixes if half of the fixes are false
    gross_scale_factor: float = 1.5  # nearer to 1, the usual fit estimates the scale
    unit_tolerance: float = 0.05  # a factor that near to a unit's size is this unit
    max_radians_span: float = 6.4  # [deg] headings that span more than a turn in radians are none

    # Clocks and arrival
    max_clock_difference_s: float = 0.1  # log time minus stamp may differ by as much between DVL and heading
    max_epoch_difference_s: float = 3600.0  # beyond, the stamps are of another clock, which the reader reports
    max_logging_delay_s: float = 5.0  # from measuring to logging: no driver takes longer
    notable_delay_s: float = 0.2  # a fix that arrives later matters to an online filter
    sentinel_tolerance_mps: float = 5e-4  # half of the last digit of the velocities that mean "no bottom lock"

    # A proposal for the map's origin, and the search for topics
    max_pair_gap_s: float = 2.0  # between a fix and a GPS fix: a vehicle moves a few metres in that time
    min_pairs: int = 3  # fewer show no scatter
    max_topic_combinations: int = 12  # tried if several sensors have several topics: each costs a reading of the log


THRESHOLDS = Thresholds()
