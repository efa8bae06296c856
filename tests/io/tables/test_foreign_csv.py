"""CSV files that other programs wrote: their columns say what they hold, and in which unit."""

import tempfile
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from commands import run
from logs import MAP, codes, columns, logged_csv, lost, only, places, read_as, refusal
from recordings import SECOND, T0, saved, write_csv
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.formats.detect import open_reader
from usbldr.io.messages.field_names import sensors_by_name
from usbldr.io.reading.read import read_log
from usbldr.io.tables.cells import numbers
from usbldr.io.tables.csv_sheets import sheet_of
from usbldr.io.tables.csv_text import read_texts
from usbldr.io.tables.date_times import with_iso_times
from usbldr.io.units import named_unit

HEAD = "[usbl]\nhead = { east_m = 0.0, north_m = 0.0 }\n"
T = T0 // SECOND
WIDE = f"""
    "Time [s]", "DVL X [m/s]", "DVL Y [m/s]", "DVL Z [m/s]", "Heading (deg)", "Depth [m]", "Temperature [C]"
    {T}.25, 1.5, -0.25, 0.01, 30.5, 12.5, 8
    {T + 1}.25, 1.6, -0.35, 0.02, 31.5, 12.6, 8
"""


def timed(text: str) -> str:
    """Put a column of times in seconds before the others."""
    names, *rows = text.split("\n")
    return "\n".join([f"Time [s],{names}", *(f"{T + k},{row}" for k, row in enumerate(rows))])


def test_a_wide_file_holds_several_sensors(tmp_path: Path) -> None:
    log = logged_csv(tmp_path, '[dvl]\naxes = "FSD"', dive=WIDE)
    by_default = logged_csv(tmp_path, "", dive=WIDE).convention("dvl", "axes")

    wanted = {"dvl.forward_mps": [1.5, 1.6], "dvl.starboard_mps": [-0.25, -0.35], "dvl.up_mps": [-0.01, -0.02]}
    wanted |= {"compass.heading_deg": [30.5, 31.5], "depth.depth_m": [12.5, 12.6]}
    assert columns(log, wanted) == wanted
    assert log.start_ns == T0 + SECOND // 4
    assert [p.topic for p in log.provenance.values()] == ["/dive/dvl", "/dive/compass", "/dive/depth"]
    read_by = "/dive/dvl: read by the names of its columns: x_mps from DVL X [m/s], y_mps from DVL Y [m/s], "
    assert read_by in next(finding.text for finding in log.findings if finding.code == "COLUMNS-BY-NAME")
    assert (by_default.value, by_default.chosen_by) == ("FLU", "default")


FRD_COLUMNS = '[dvl]\naxes = "FRD"\ncolumns = { time_unix_s = "t", x = "vf", y = "vs" }\n'
BY_KEYS = f'{FRD_COLUMNS}[compass]\ncolumns = {{ time_unix_s = "t", heading = "hdg" }}\n'


@pytest.mark.parametrize(
    ("names", "toml"), [("Time [s],DVL X [m/s],DVL Y [m/s],Heading (deg)", ""), ("t,vf,vs,hdg", BY_KEYS)]
)
def test_a_row_without_a_value_of_a_sensor_is_no_record_of_it(tmp_path: Path, names: str, toml: str) -> None:
    log = logged_csv(tmp_path, toml, dive=f"{names}\n{T}.0,1.5,0.25,\n{T}.1,,,30.5\n{T}.2,,,31.5\n{T}.3,1.6,,\n")

    assert log.tables["compass"]["heading_deg"].tolist() == [30.5, 31.5]
    assert {"COMPASS-INVALID", "SAME-STAMP"}.isdisjoint(codes(log))
    assert "1 of 2 records are invalid" in only(log, "DVL-INVALID")  # a value is missing


@pytest.mark.parametrize("more", ["", ",Roll [rad]"])
def test_roll_and_pitch_beside_a_heading_are_read_if_there_is_one_of_each(tmp_path: Path, more: str) -> None:
    rows = "".join(f"{T + k},30.5,1.5,-2{',0' * (more != '')}\n" for k in range(9))

    log = logged_csv(tmp_path, "", ins=f"Time [s],INS Heading (deg),INS Roll (deg),Pitch [°]{more}\n{rows}")

    assert log.tables["compass"]["heading_deg"].tolist() == [30.5] * 9
    found = None if log.attitude is None else log.attitude[["roll_deg", "pitch_deg"]].mean().tolist()
    assert found == (pytest.approx([1.5, -2.0]) if not more else None)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("usbl", "time_unix_s,east_m,north_m\n" + "".join(f"1.76723E+09,{k},0\n" for k in range(400)),
         "400 records have one and the same time; export their times with more digits"),
        ("compass", "time_ns,heading_deg\n12:00,10\n12:01,11",
         r'line 2: time_ns is "12:00", not a whole number of nanoseconds'),
        ("a", "Zeit,Kurs [deg]\n05/06/2026 01:30:00,30\n",
         r"no topic can be read: /a: its columns .* name them with the key columns"),
    ],
    ids=["all the same are no wrong unit", "a time of day among nanoseconds", "dates are not the reason"],
)  # fmt: skip
def test_why_times_cannot_be_used_is_said(tmp_path: Path, name: str, text: str, said: str) -> None:
    with pytest.raises(LogError, match=said):
        logged_csv(tmp_path, "", **{name: text})


def test_what_two_sensors_of_one_topic_have_in_common_is_said_once(tmp_path: Path) -> None:
    rows = [f"{second % 86_400},1.5,0.25,30.5" for second in range(86_370, 86_430)]

    log = logged_csv(tmp_path, BY_KEYS.replace("time_unix_s", "time_s"), dive="\n".join(["t,vf,vs,hdg", *rows]))

    assert {one.topic for one in log.provenance.values()} == {"/dive"}
    assert [one.code for one in log.findings].count("CLOCK-WRAP") == 1


@pytest.mark.parametrize(
    ("name", "header"),
    [
        ("replies", "Range [m],Bearing [deg],roll [deg],pitch [deg]"),
        ("replies", "Distance [m],Azimuth [deg],roll [deg],pitch [deg]"),
        ("replies", "R [m],azimuth_deg,elevation_deg,roll_deg"),
        ("replies", "x_m,y_m,azimuth_deg,roll_deg"),
        ("replies", "azimuth_deg,roll_deg,pitch_deg,Beacon"),
        ("usbl", "azimuth_deg,roll_deg,pitch_deg"),
        ("gps", "lat_deg,lon_deg,course_deg,roll_deg"),
        ("attitude", "course_over_ground_deg,roll_deg"),
        ("attitude", "target_course_deg,roll_deg"),
        ("sonar", "bearing_deg,intensity"),
    ],
)
def test_the_direction_of_a_transponder_or_of_a_motion_is_no_heading(name: str, header: str) -> None:
    assert "compass" not in sensors_by_name(["Time [s]", *header.split(",")], name)


def test_units_of_the_header_are_converted(tmp_path: Path) -> None:
    log = logged_csv(
        tmp_path,
        MAP + HEAD,
        doppler="stamp_ms,Forward (mm/s),Port [cm/s],Down [knots],sigma [mm/s],velocity_valid\n"
        f"{T0 // 10**6},1500,20,1,5,1\n{T0 // 10**6 + 500},1500,20,1,5,0",
        ahrs=f"epoch_us,hdg_rad\n{T0 // 1000},1.5",
        ctd="UTC,Pressure [dbar]\n2020-09-13T12:26:40Z,20.1325",
        gnss=f"t_s,latitude_rad,longitude_rad,accuracy_cm\n{T},0.7854,0.1222,150",
        usbl=f"stamp_ns,received_ns,slant_range_mm,bearing_rad\n{T0},{T0 + SECOND},250000,0.5",
    )  # fmt: skip

    wanted = {"dvl.forward_mps": [1.5] * 2, "dvl.starboard_mps": [-0.2] * 2, "dvl.up_mps": [-1852 / 3600] * 2}
    wanted |= {"compass.heading_deg": [np.degrees(1.5)], "depth.depth_m": [1e5 / (1025.0 * 9.80665)]}
    wanted |= {"gps.lat_deg": [np.degrees(0.7854)], "gps.lon_deg": [np.degrees(0.1222)]}
    wanted |= {"dvl.sd_mps": [0.005] * 2, "gps.sd_m": [1.5]}
    assert columns(log, wanted) == {name: pytest.approx(values, rel=1e-12) for name, values in wanted.items()}
    assert list(log.tables["dvl"]["valid"]) == [True, False]
    assert log.start_ns == T0


AHEAD = {"dvl.forward_mps": [1.5], "dvl.starboard_mps": [0.25], "compass.heading_deg": [30.5]}
TOULON = {
    "gps.lat_deg": pytest.approx([43 + 6.5 / 60], rel=0, abs=1e-12),
    "gps.lon_deg": pytest.approx([-(5 + 54.25 / 60)], rel=0, abs=1e-12),
    "compass.heading_deg": [30.5, 31],
}
SOUTH_WEST = {"gps.lat_deg": pytest.approx([-45.5]), "gps.lon_deg": pytest.approx([-30.25])}
AT_HEAD = {"usbl.east_m": pytest.approx([100.0]), "usbl.north_m": pytest.approx([0.0], abs=1e-9)}
UNDERSTOOD = {  # what is understood: file, text, columns
    "ranges": ("ranger", f"Range [m],Bearing [rad]\n100,{np.pi / 2}", AT_HEAD),
    "true bearings": ("ranger", "Slant Range (m),True Bearing (deg)\n100,90", AT_HEAD),
    "aft and port": ("dive", "Aft velocity [cm/s],Port velocity [cm/s],Compass [deg]\n-150,-25,30.5", AHEAD),
    "figures of merit": ("dive", "Velocity Fwd [m/s],Velocity Stbd [m/s],FOM Fwd [m/s],Var Stbd [m/s],Heading (deg)\n"
                         "1.5,0.25,9,9,30.5", AHEAD),
    "gon": ("dive", "Forward (m/s),Starboard (m/s),Heading [gon]\n1.5,0.25,33.888888888888886",
            AHEAD | {"compass.heading_deg": [pytest.approx(30.5)]}),
    "speeds": ("dive", "Surge Speed (m/s),Starboard Velocity (m/s),Heading True (deg)\n1.5,0.25,30.5", AHEAD),
    "a value in a file of its quantity": ("Depth", "entity,value (cm)\nCTD,200", {"depth.depth_m": [2]}),
    "units behind dots": ("dive", "dvl.fwd.mps,dvl.stbd.mps,heading.deg\n1.5,0.25,30.5", AHEAD),
    "true degrees in cells": ("compass", "Heading\n030.5°T\n031.0°T", {"compass.heading_deg": [30.5, 31]}),
    "durations beside times": ("dive", "Forward (m/s),Starboard (m/s),Heading (deg),Elapsed\n"
                               "1.5,0.25,30.5,0 days 00:00:01.5", AHEAD),
    "units without brackets": ("dive", "DVL Fwd m/s,DVL Stbd m/s,HDG_T deg\n1.5,0.25,30.5", AHEAD),
    "names in quotes": ("dive", '"Vel Fwd [m/s]","Vel Right [m/s]","HDT, deg"\n1.5,0.25,30.5', AHEAD),
    "the body": ("dive", "Forward Velocity BT (m/s),Starboard (body) [m/s],Heading Angle (deg)\n1.5,0.25,30.5", AHEAD),
    "German": ("dive", "Geschwindigkeit voraus (m/s),Geschwindigkeit rechts (m/s),Steuerkurs (°)\n1.5,0.25,30.5",
               AHEAD),
    "short German": ("dive", "V voraus [m/s],V stb [m/s],Heading rw [°]\n1.5,0.25,30.5", AHEAD),
    "Norwegian": ("dykk", "Fart fremover [m/s],Fart styrbord [m/s],Kompasskurs [°]\n1.5,0.25,30.5", AHEAD),
    "French": ("plongée", "Vitesse avant (m/s),Vitesse bâbord (m/s),Cap vrai (°)\n1.5,-0.25,30.5", AHEAD),
    "Spanish units": ("x", "Velocidad avante [nudos],Velocidad estribor (nudos),Rumbo verdadero (grados)\n"
                      f"{1.5 / 1852 * 3600},{0.25 / 1852 * 3600},30.5",
                      {name: pytest.approx(values) for name, values in AHEAD.items()}),
    "Norwegian courses": ("dykk", "Fart fremover [m/s],Fart styrbord [m/s],Kurs rettvisende [grader]\n1.5,0.25,30.5",
                          AHEAD),
    "German courses": ("dive", "Voraus [m/s],Steuerbord [m/s],Kurs rechtweisend [°]\n1.5,0.25,30.5", AHEAD),
    "systems behind": ("x", "Latitud USBL (grados),Longitud USBL (grados)\n45,-30", {"usbl.east_m": [0]}),
    "transponders": ("x", "TP_LAT [deg],TP_LON [deg]\n45,-30", {"usbl.east_m": [0]}),
    "Spanish": ("x", "Velocidad atrás (cm/s),Velocidad estribor (cm/s),Rumbo (°)\n-150,25,30.5", AHEAD),
    "parts of units": ("dive", "vFwd_mm_s,vStbd_mm_s,hdg_cdeg\n1500,250,3050", AHEAD),
    "Prometheus": ("dive", '"fwd_mps {a=""dvl"", b=""1""}","{__name__=""stbd_mps"",a=""1""}","hdg_deg {a: ""1""}"\n'
                   "1.5,0.25,30.5", AHEAD),
    "Bredde and Lengde": ("x", "HiPAP Bredde,HiPAP Lengde\n45,-30", {"usbl.east_m": [0]}),
    **{brand: ("x", f"{brand} Latitude (deg),{brand} Longitude (deg)\n45,-30", {"usbl.east_m": [0]})
       for brand in ("HiPAP", "muPAP", "GAPS", "SeaTrac", "EvoLogics", "S2C", "TrackLink", "EasyTrak", "BAC")},
    "degrees and minutes with signs": ("gps", "gps_lat_ddmm,gps_lon_dddmm\n-4530.000,-3015.000\n-4460.000,-3000.000",
                                       {"gps.lat_deg": pytest.approx([-45.5, -45]), "gps.lon_deg": [-30.25, -30]}),
    "degrees, minutes and seconds": ("gps", "Lat (DDMMSS.ss),N/S,Lon (DDDMMSS.ss),E/W\n453000.00,S,0301500.00,W",
                                     SOUTH_WEST),
    "degrees, minutes and seconds with signs": ("gps", "gps_lat_ddmmss,gps_lon_dddmmss\n-452960.00,-301459.99",
                                                {"gps.lat_deg": [-45.5]}),
    "standard deviations": ("usbl", "lat_deg,lon_deg,Std Dev East [m],Std Dev North [m]\n45,-30,1.5,1.5",
                            {"usbl.east_m": [0]}),
    "offsets": ("usbl", "Offset East [m],Offset North [m],lat_deg,lon_deg\n5,5,45,-30", {"usbl.east_m": [0]}),
    "quantities and their quality": ("x", "quantity,value,unit,quality\nheading,30.5,deg,Good\nheading,9,deg,Bad",
                                     {"compass.heading_deg": [30.5]}),
    "decimal commas of minutes": ("gps", "Lat [°],Lon [°]\n\"45° 30,00' S\",\"30° 15,00' W\"", SOUTH_WEST),
    "a grid behind the unit": ("x", 'USBL Easting (m) UTM26N,USBL Northing (m) UTM26N\n263553.9,4987329.5',
                               {"usbl.east_m": [263553.9]}),
    "units in cells": ("dive", "Forward,Starboard,Heading (deg)\n1500 mm/s,250 mm/s,30.5", AHEAD),
    "bottom track": ("dive", "Forward (m/s),Starboard (m/s),Bottom Track,Heading [deg]\n1,0,lost,9\n1,0,locked,9",
                     {"dvl.valid": [False, True]}),
    **{flag: ("dive", f"Fwd [m/s],Stbd [m/s],{flag}\n1.5,0.5,0\n1.5,0.5,1", {"dvl.valid": [False, True]})
       for flag in ("BT Valid", "Vel valid", "BT Lock")},
    **{header: (name, f"{header}\n30\n31", {"compass.heading_deg": [30, 31]})
       for name, header in (("compass", "azimuth_deg"), ("compass", "Bearing [deg]"), ("attitude", "course_deg"))},
    "an azimuth beside a roll": ("ins", "azimuth,roll,pitch\n30,0.5,0.5", {"compass.heading_deg": [30]}),
    "an azimuth beside velocities": ("dive", "Azimuth (deg),Forward (m/s),Starboard (m/s)\n30.5,1.5,0.25", AHEAD),
    "a status beside satellites": ("gps", "Status,NSats,lat_deg,lon_deg\n1,9,1,2\n0,9,2,2\n2,9,3,2",
                                   {"gps.lat_deg": [3]}),
    "a status": ("gps", "Status,lat_deg,lon_deg\n1,1,2\n0,2,2\n3,3,2\n2,4,2", {"gps.lat_deg": [3, 4]}),
    "kinds of fixes": ("gps", "Fix,lat_deg,lon_deg\nNo_Fix,1,2\n3D,2,2\n0,3,2\n1,4,2", {"gps.lat_deg": [2, 4]}),
    "our own flag": ("dvl", "starboard_mps,forward_mps,sd_mps,valid\n0.1,1.5,0.02,1\n0.1,1.5,0.02,0",
                     {"dvl.valid": [True, False], "dvl.sd_mps": [0.02, 0.02]}),
    "our own sigma": ("compass", "heading_deg,sd_deg\n10,0.7\n11,0.7", {"compass.sd_deg": [0.7, 0.7]}),
    "German degrees": ("dive", "Vorwärts [m/s],Rechts [m/s],Steuerkurs (Grad)\n1.5,0.25,30.5", AHEAD),
    "a course beside velocities": ("dive", "Voraus [m/s],Steuerbord [m/s],Kurs (Grad)\n1.5,0.25,30.5", AHEAD),
    "gyrocompasses": ("dive", "Forward (m/s),Starboard (m/s),Gyro 1 [deg]\n1.5,0.25,30.5", AHEAD),
    "degrees with colons": ("gps", "Lat_dms,Lon_dms\n045:30:00.0S,030:15:00.0W", SOUTH_WEST),
    "short": ("dive", "Fwd_Spd_mps,Stbd_Spd_mps,Hdg_deg\n1.5,0.25,30.5", AHEAD),
    "degrees and minutes": ("dive", "Heading (deg),GPS Lat,GPS Lon\n30.5,,\n31,43° 06.5' N,5° 54.25' W", TOULON),
    "dashes": ("dive", "Heading (deg),GPS Lat,GPS Lon\n30.5,,\n31,43-06.5N,005-54.25W", TOULON),
    "water track beside": ("dive", "BT Forward m/s,BT Starboard m/s,WT Forward m/s,WT Starboard m/s,Heading (deg)\n"
                           "1.5,0.25,9,9,30.5", AHEAD),
    "blanks": ("dive", "Heading (deg),GPS Latitude,GPS Longitude\n30.5,,\n31,43 06.5 N,005 54.25 W", TOULON),
    "NMEA": ("dive", "Heading (deg),GPS Lat,GPS N/S,GPS Lon,GPS E/W\n30.5,,,,\n31,4306.5,N,00554.25,W", TOULON),
    "degrees apart from minutes": ("dive", "Heading (deg),GPS Lat Deg,GPS Lat Min,N/S,GPS Lon (deg),GPS Lon (min),E/W\n"
                                   "30.5,,,,,,\n31,43,06.5,N,005,54.25,W", TOULON),
    "seconds apart": ("gps", "lat_deg,lat_min,lat_sec,lon_deg,lon_min,lon_sec\n-45,29,60,-30,15,0", SOUTH_WEST),
    "sides": ("gps", "Latitude [deg],N/S,Longitude [deg],E/W\n45.5,S,30.25,W", SOUTH_WEST),
    "sides before": ("gps", "NS,Latitude [deg],EW,Longitude [deg],mode\nS,45.5,W,30.25,A", SOUTH_WEST),
    "sides and signs": ("gps", "Latitude [deg],Longitude [deg],lat dir,lon dir\n-45.5,-30.25,S,W", SOUTH_WEST),
    "no sides": ("gps", "Latitude [deg],Longitude [deg],ok,mode\n-45.5,-30.25,N,A", SOUTH_WEST),
    "our own names": ("usbl", "east_m,north_m,cov_ee_m2,cov_en_m2,cov_nn_m2,depth_m\n1,2,4,1,9,20",
                      {"usbl.cov_ee_m2": [4], "usbl.cov_en_m2": [1], "usbl.cov_nn_m2": [9]}),
    "local fixes": ("fixes", "USBL East [cm],USBL North [cm]\n4000,-2000",
                    {"usbl.east_m": [40], "usbl.north_m": [-20]}),
}  # fmt: skip


@pytest.mark.parametrize("case", UNDERSTOOD)
def test_names_and_cells_of_other_programs_are_understood(tmp_path: Path, case: str) -> None:
    file, text, wanted = UNDERSTOOD[case]

    assert columns(logged_csv(tmp_path, HEAD * (wanted == AT_HEAD), **{file: timed(text)}), wanted) == wanted


def test_a_sensor_whose_unit_is_unknown_does_not_hide_the_others(tmp_path: Path) -> None:
    text = timed("Heading (deg),USBL Latitude,USBL Longitude,Battery\n30.5,.75,.1,24\n31,,,24")
    folder = write_csv(tmp_path / "dive", nav=text)

    compass, usbl = open_reader(folder).topics()

    assert (compass.name, compass.count, compass.problem) == ("/nav/compass", 2, "")
    assert usbl.problem.startswith("nav.csv has a column USBL Latitude without a known unit (deg, rad, gon, mil")
    unread = ("USBL Latitude", "USBL Longitude", "Battery")
    assert compass.unused == usbl.unused == unread
    assert f"columns of /nav that no sensor uses: {', '.join(unread)}\n" in run("info", folder).stdout


@pytest.mark.parametrize(
    ("names", "cells", "as_utc"),
    [
        ("Time (UTC+2),Heading (deg)", "2020-09-13 14:26:40", ""),
        ("Time [+02:00],Heading (deg)", "2020-09-13T14:26:40.0", ""),
        ("Time GMT-3:30,Heading (deg)", "13.09.2020 08:56:40", ""),
        ("Date,Time (UTC+02),Heading (deg)", "13.09.2020,14:26:40", ""),
        ("Time,Heading\n(UTC+2),(deg)", "2020-09-13 14:26:40", ""),
        ("Time (UTC+2),Heading (deg)", "2020-09-13 12:26:40Z", ""),
        ("Time (Europe/Oslo),Heading (deg)", "2020-09-13 14:26:40", ""),
        ("Time [America/New_York],Heading (deg)", "09/13/2020 8:26:40 AM", ""),
        ("Time (UTC+2),Heading (deg)", "2020-09-13 13:26:40+01:00", ""),
        *((f"{name},Heading (deg)", "2020-09-13 12:26:40", f"time from {name} as UTC: of zones in names")
          for name in ("Time [MESZ]", "Local Time", "Time (PST)")),
    ],
)  # fmt: skip
def test_a_zone_in_the_name_of_a_time_holds_if_it_has_hours_and_its_cells_state_none(tmp_path, names, cells, as_utc):
    log = logged_csv(tmp_path, "", compass=f"{names}\n{cells},30.5\n{cells},30.5\n")

    assert log.start_ns == T0
    assert as_utc in codes(log)["COLUMNS-BY-NAME"]
    assert ("as UTC" in codes(log)["COLUMNS-BY-NAME"]) == bool(as_utc)


def test_times_of_day_without_a_date_get_that_of_each_file(tmp_path: Path) -> None:
    compass = "Time,Heading (deg)\n23:59:59.5,30\n00:00:00.5,31\n"
    depth = "Time,Depth (m)\n00:00:00.25,3\n00:00:01.25,3\n"
    undated = logged_csv(tmp_path, "", compass=compass, depth=depth)
    of_files = '[[file]]\npath = "{}.csv"\ndate = {}\n'
    toml = of_files.format("compass", "2020-09-12") + of_files.format("depth", "2020-09-13")

    log = logged_csv(tmp_path, toml, compass=compass, depth=depth)

    said = "compass.csv, depth.csv: the times have no date; the first day is taken as 1970-01-01; state path and date"
    assert codes(undated)["NO-DATE"].startswith(said)
    assert log.start_ns == 1_599_955_200 * SECOND - SECOND // 2
    assert log.tables["compass"]["time_s"].tolist() == [0.0, 1.0]
    assert log.tables["depth"]["time_s"].tolist() == undated.tables["depth"]["time_s"].tolist() == [0.75, 1.75]
    assert "NO-DATE" not in codes(log)


@pytest.mark.parametrize(("name", "level"), [("Foo", "error"), ("Bar", "warning"), ("EKF", ""), ("Foo_m", "")])
def test_a_position_that_no_sensor_uses_is_named(tmp_path: Path, name: str, level: str) -> None:
    text = timed(
        f"Heading (deg),{name} Lat [deg],{name} Lon [deg]\n30,45,-30\n31,45,-30".replace("_m Lat [deg]", " Width")
    )
    usbl = {"usbl": f"time_ns,east_m,north_m\n{T0},1,2\n"} if name == "Bar" else {}

    found = [one for one in logged_csv(tmp_path, "", dive=text, **usbl).findings if one.code == "TOPIC-UNREAD"]

    assert [one.level if one.lost_data else "warning" for one in found] == [level] * bool(level)
    assert all(f'lat_deg = "{name} Lat [deg]", lon_deg = "{name} Lon [deg]" }};' in one.text for one in found)


SHIP = "Ship Latitude [deg],Ship Longitude [deg],Ship Heading [deg]"
ON_SHIP = 'head = { topic = "/usbl/ship/gps", heading_topic = "/usbl/ship/compass" }'
FROM_SHIP = [
    ("Slant Range [m],Relative Bearing [deg]", "{0},{along:.0f}"),
    ("Range (m),rel_brg_deg", "{0},{along:.0f}"),
    ("Slant Range [m],Bearing [deg]", "{0},90"),
    ("USBL Starboard Offset [m],USBL Forward Offset [m]", "0,{0}"),
    ("Target X (stbd) [m],Target Y (fwd) [m]", "0,{0}"),
    ("USBL East Offset [m],USBL North Offset [m]", "{0},0"),
    ("USBL dE [m],USBL dN [m]", "{0},0"),
]


@pytest.mark.parametrize(("names", "cells"), FROM_SHIP)
def test_fixes_count_from_the_ship_whose_place_and_heading_are_beside(tmp_path: Path, names: str, cells: str) -> None:
    rows = "".join(f"\n{cells.format(away, along=0)},45,-30,90" for away in (100, 101))

    log = logged_csv(tmp_path, f"[usbl]\n{ON_SHIP}", usbl=timed(f"{names},{SHIP}{rows}"))

    assert places(log) == pytest.approx(np.array([[100, 0], [101, 0]]), abs=1e-6)
    assert "gps" not in log.tables


@pytest.mark.parametrize(("names", "cells"), FROM_SHIP)
def test_fixes_from_a_ship_need_its_place(tmp_path: Path, names: str, cells: str) -> None:
    text = timed(f"{names}\n{cells.format(100, along=0)}")

    assert "state head = {...} under [usbl]" in refusal(LogError, logged_csv, tmp_path, "", usbl=text)


def test_horizontal_ranges_are_not_taken_for_slant_ranges(tmp_path: Path) -> None:
    text = timed("Horizontal Range [m],Bearing [deg]\n100,90")

    assert "holds horizontal ranges; write slant ranges" in refusal(UsageError, logged_csv, tmp_path, HEAD, usbl=text)


@pytest.mark.parametrize("name", ["Beacon", "BeaconID", "Target", "transponder_no"])
@pytest.mark.parametrize("header", ["time_ns,{},east_m,north_m", "Time [ns],{},East [m],North [m]"])
def test_a_column_of_targets_beside_fixes_is_theirs(tmp_path: Path, header: str, name: str) -> None:
    usbl = f"{header.format(name)}\n{T0},B01,1,2\n{T0 + SECOND},SHIP,500,600\n"

    said = refusal(UsageError, logged_csv, tmp_path, "", usbl=usbl)

    assert "holds fixes of 2 targets: B01 (1 fixes), SHIP (1 fixes)" in said
    assert places(logged_csv(tmp_path, '[usbl]\ntarget = "B01"', usbl=usbl)).tolist() == [[1.0, 2.0]]


@pytest.mark.parametrize(
    ("status", "used", "unknown"),
    [
        ("OK BAD good", [1, 3], ""),
        ("Accepted Rejected Accept Reject", [1, 3], ""),
        ("A V A", [1, 3], ""),
        ("1 0 2", [1, 2, 3], ""),
        ("OK WEAK BAD", [1, 2], "used: weak;"),
        ("OK LOST LOCKED", [1, 3], ""),
    ],
)
def test_words_of_a_status_beside_fixes_are_flags(tmp_path: Path, status: str, used: list[int], unknown: str) -> None:
    rows = "\n".join(f"{word},{k},2" for k, word in enumerate(status.split(), start=1))

    log = logged_csv(tmp_path, "", usbl=timed(f"Status,East [m],North [m]\n{rows}"))

    assert log.tables["usbl"]["east_m"].tolist() == used
    assert unknown in codes(log).get("FLAG-WORDS", "")
    assert ("FLAG-WORDS" in codes(log)) == bool(unknown)


@pytest.mark.parametrize(
    ("name", "header", "cells", "why"),
    [
        ("nav", "Time [s],Heading [turn]", "1,1",
         "has a column Heading [turn] without a known unit (deg, rad, gon, mil, 0.1deg, 0.01deg, 1e-7deg)"),
        ("nav", "Time [s],Heading (deg),Depth", "1,1,1",
         "has a column Depth without a known unit (m, dm, cm, mm, km, ft)"),
        ("nav", "Time,Heading (deg)", "1,1",
         'has a column Time without a known unit; write it behind the name ("Time [s]")'),
        ("nav", "Time [s],stamp_ns,Heading (deg)", "1,1,1",
         'has columns for the same quantity (Time [s], stamp_ns); choose one under [compass]: columns = { time_'),
        ("nav", "Heading (deg),Roll (deg)", "1,1",
         "has not one column of time (none); name its columns with the key columns of a"),
        ("nav", "t_s,IMU Heading (deg),AHRS Heading (deg)", "1,1,1",
         "has columns for the same quantity (IMU Heading (deg)"),
        ("compass", "Time,Heading [deg]", "2026-01-01 02:00:00 CEST,1",
         'has "2026-01-01 02:00:00 CEST" in the first row of the column Time, which is neither a date and time nor a'),
        ("compass", "Time,Heading [deg]", "23:01.5,1",
         'has "23:01.5" in the first row of the column Time: minutes and seconds without the hour'),
        ("compass", "DOY,Heading [deg]", "257.5185185,1",
         'has a column DOY of days of a year, without the year; add a column "year"'),
        ("compass", "Time,Heading [deg]", "257:12:26:40.5,1",
         'has "257:12:26:40.5" in the first row of the column Time: a day of a year, without'),
        ("compass", "Time,Heading [deg]", ",1",
         "has a column Time of which neither a unit nor a date is known; write the unit"),
        ("compass", "gps_time,Heading [deg]", "1451260818.5,1",
         "has a column gps_time that may count from 1970 or, as GPS time,"),
        ("compass", "GPS seconds [s],Heading [deg]", "1451260818.5,1",
         "has a column GPS seconds [s] that may count from 1970 or"),
        ("compass", "Time [s],Heading [turn]", "1,1",
         "has a column Heading [turn] without a known unit (deg, rad, gon, mil, 0.1deg, 0.01deg, 1e-7deg)"),
        ("compass", "YR,MO,DA,HH,MM,SS,HH,Heading [deg]", "26,5,18,12,30,1,50,1",
         "has two columns HH; rename one"),
        ("compass", "Time [s],Heading [deg],Heading [deg]", "1,1,1",
         "has columns of one name (Heading [deg], Heading [deg]); rename them"),
        ("dvl", "1600000000,5,dvl_link,1.5,0.5", "1600000000,5,dvl_link,1.5,0.5",
         "has no header: its first line holds values, so its columns are 1, 2, ...; name them"),
    ],
)  # fmt: skip
def test_what_a_header_leaves_open_is_refused_in_one_sentence(tmp_path, name, header, cells, why):
    folder = write_csv(tmp_path / "dive", **{name: f"{header}\n{cells}"}, depth=f"time_ns,depth_m\n{T0},3")

    (problem,) = {topic.problem for topic in open_reader(folder).topics() if topic.problem}

    assert problem.startswith(f"{name}.csv {why}")


LABVIEW = "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t,\nSamples\t2\t2\n\n"
TIMED = "Time,Heading [deg]\n2026-01-01T00:00:00Z,1.5\n2026-01-01T00:00:01Z,2.5\n"
SHEET = 'sep=;\r\nTime;Heading;;\r\n;deg;;\r\n18.05.2026 12:00:00;="1,5";;\r\n18.05.2026 12:00:01;="2,5";;\r\n'
BLANKS = "time_s heading_deg  forward_mps starboard_mps\n 0 1.5  NaN nan\n 0.5  NaN  1 0.25\n 1.0 2.5 1 0.25\n"
NOTED = "Time [s],Heading (deg),Note\n0,1.5,1\n1,2.5,2\n"
ENDS = [
    "(2 rows)\n",
    "\n-- end of file --\n\n",
    "Total: 2 records\nEOF",
    "# EOF\n",
    "END,,\n",
    "***END***\n",
    "Mean,1.5,\nRange:,2,1\n",
]
AROUND = {  # what other programs write around a table, and the heading in it
    "what spreadsheets add": SHEET.encode("utf-8-sig"),
    "words with their values before the names": f"{LABVIEW}Time [s]\tHeading [deg]\tRoll\n0,0\t1,5\t0\n0,5\t2,5\t0\n",
    "line breaks in names": '"Time\n[s]","Heading\n[deg]",Note\r\n0,1.5,\r\n1,2.5,x\r\n',
    "line breaks in names, else clean": '"Time\n[s]","Heading\n[deg]"\n0,1.5\n1,2.5\n',
    "an older encoding": "Time [s],Heading [°]\n0,1.5\n1,2.5\n".encode("latin-1"),
    "a table of other columns without rows": f"{TIMED}Time,Depth [m]\n",
    "summaries in a clean file": f"{TIMED.replace('T00', ' 00')}Mean,2\n",
    "two returns": TIMED.replace("\n", "\r\r\n"),
    **{f"blanks between columns, behind {mark!r}": mark + BLANKS for mark in ("", "# ", "   ")},
    **{f"{end!r}, {mark!r} between": f"{NOTED}{end}".replace(",", mark) for end in ENDS for mark in (",", ";", "|")},
    **{
        f"{between!r} between rows, {end!r} at their ends": end.join(
            ["Time [s],Heading [deg]", between, "0,1.5", between, "1,2.5", between, ""]
        )
        for between in ("# a remark", "% a remark, twice", "// a remark", ",", ",,", "  ")
        for end in ("\n", "\r\n")
    },
}


@pytest.mark.parametrize("case", AROUND)
def test_what_other_programs_write_around_a_table_is_none_of_it(tmp_path: Path, case: str) -> None:
    log = read_log(saved(tmp_path / "compass.csv", AROUND[case]))

    assert log.tables["compass"]["heading_deg"].tolist() == [1.5, 2.5]
    assert "dvl" not in log.tables or log.tables["dvl"]["starboard_mps"].tolist() == [0.25, 0.25]
    assert not lost(log)


@pytest.mark.parametrize(
    ("names", "units"),
    [
        ("Time [s],DVL Forward [m/s],DVL Starboard [m/s]", "s,m/s,m/s"),
        ("Time [s],DVL Forward [m/s],DVL Starboard [m/s]", "[s],[m/s],"),
        ("Time [s],DVL Forward [m/s],DVL Starboard [m/s]", "-,-,-"),
        ("time_ns,forward_mps,starboard_mps", "ns,m/s,m/s"),
        ("Time,DVL Forward,DVL Starboard,Roll", "s,m_s,m_s,deg"),
        ("Time,DVL,,Roll", "[s],Forward [m/s],Starboard [m/s],[deg]"),
        ("Time,DVL,DVL,Roll,", ",Forward,Starboard,,\ns,m/s,m/s,deg,"),
    ],
)
def test_lines_of_units_or_under_a_common_name_are_no_rows(tmp_path: Path, names: str, units: str) -> None:
    rows = [",".join([str(T + k), "1.5", "0.5", "3"][: len(names.split(","))]) for k in range(2)]

    log = logged_csv(tmp_path, "", dvl="\n".join([names, units, *rows]))

    assert log.tables["dvl"]["forward_mps"].tolist() == [1.5, 1.5]
    assert not lost(log)


TITLES = "Survey sheet 1,,,,\nExported by Excel,,,,\n,,,,\nTime,Gyro,USBL,,\nTime,Heading,Latitude,Longitude,\n"
OVER = "Time,USBL,,GPS,\n[s],Lat [deg],Lon [deg],Lat [deg],Lon [deg]\n1,2,3,4,5\n"
OVER_NAMES = ["Time [s]", "USBL Lat [deg]", "USBL Lon [deg]", "GPS Lat [deg]", "GPS Lon [deg]"]
TITLED = f"{TITLES}s,deg,deg,deg,\n1,2,3,4,\n2,,3,4,\n"
TITLED_NAMES = ["Time [s]", "Gyro Heading [deg]", "USBL Latitude [deg]", "USBL Longitude [deg]"]


@pytest.mark.parametrize(
    ("text", "names"),
    [(OVER, OVER_NAMES), *((TITLED.replace(",", separator), TITLED_NAMES) for separator in (",", ";", "\t"))],
)
def test_names_over_several_columns_go_before_those_below_and_titles_are_none(tmp_path, text, names):
    table = read_texts(saved(tmp_path / "dive.csv", text))

    cells = {name: float(cells[0]) for name, cells in table.columns.items()}

    assert cells == {name: k for k, name in enumerate(names, 1)}


BY_NAME = '[dvl]\ncolumns = {{ time_unix_s = "at", x = "{}", y = "vy" }}\naxes = "FSD"\n'


@pytest.mark.parametrize(
    ("toml", "dvl", "unused"),
    [
        *((BY_NAME.format(name), f"at,vx,vy\ns,cm/s,mm/s\n{T},150,-250\n", False) for name in ("vx", "vx [cm/s]")),
        ('[dvl]\nunit = "cm/s"\naxes = "FSD"', timed("DVL X [mm/s],DVL Y [mm/s]\n1500,-250"), True),
    ],
)
def test_units_of_a_file_hold_for_columns_of_the_configuration_and_before_its_unit(tmp_path, toml, dvl, unused):
    log = logged_csv(tmp_path, toml, dvl=dvl)

    assert log.tables["dvl"][["forward_mps", "starboard_mps"]].to_numpy()[0] == pytest.approx([1.5, -0.25])
    assert ("KEY-UNUSED" in codes(log)) == unused


NO_VALUES = (
    *("NA", "n/a", "#N/A", "null", "None", "-", "---", "", "#NV", "#DIV/0!", "-nan(ind)", "-nan", "1.#QNAN", "-1.#IND"),
    *("--.--", "**.**", "--:--:--"),
    *("<NA>", "NaT", "(null)", "?", "***", "no data", "invalid", r"\N"),
)


def test_a_table_of_a_ship_is_one_of_its_receiver() -> None:
    ship, other = (sheet_of(stem, ["time_ns", "lat_deg", "lon_deg"]) for stem in ("ship", "b"))
    assert ship
    assert (ship.type, other) == ("usbldr/gps", None)


@pytest.mark.parametrize("file", ["ship", "Vessel_nav", "topside"])
@pytest.mark.parametrize("names", ["Latitude [deg],Longitude [deg]", "Northing (m),Easting (m)"])
def test_positions_in_a_file_of_a_ship_are_its_and_not_the_vehicles(tmp_path: Path, file: str, names: str) -> None:
    gps = f"Time [s],Lat (deg),Lon (deg)\n{T},45.5,7.5\n"
    log = logged_csv(tmp_path, "", gps=gps, **{file: f"Time [s],{names}\n{T},45.0,7.0\n"})

    assert only(log, "ROLE-SHIP").startswith(f"/{file}: not used as gps")
    assert log.tables["gps"]["lat_deg"].tolist() == [45.5]


def test_a_cell_without_a_unit_beside_cells_with_one_is_no_number() -> None:
    assert list(numbers(["1500 mm/s", "250"], "Forward").faults) == [1]


@pytest.mark.parametrize("word", NO_VALUES)
def test_words_for_no_value_are_none(word: str) -> None:
    read = numbers(["1.5", word], "x")

    assert not read.faults
    np.testing.assert_array_equal(read.values, [1.5, np.nan])


@given(st.floats(-1e9, 1e9), st.sampled_from(["._,", "._ ", ",_.", ",_ ", "._'", ",_\xa0"]))
def test_thousands_are_parted_by_any_other_mark_than_decimals(value: float, marks: str) -> None:
    point, _, mark = marks
    text = f"{value:,.2f}".replace(",", "_").replace(".", point).replace("_", mark)
    read = numbers([text.replace(",", ".") if abs(value) < 1000 else text, "0.5"], "x")

    assert not read.faults
    assert read.values[0] == pytest.approx(round(value, 2))


@pytest.mark.parametrize(
    "header",
    ["Yaw (deg)", "Heading Rate (deg)", "Easting [m],Northing [m]", "Surge [m/s],Sway [m/s]",
     "Forward [m/s]", "x [m],y [m]", "Water X [m/s],Water Y [m/s]", "Target Heading (deg)", "Länge [m],Breite [m]",
     "USBL true_east_m,USBL true_north_m", "Latitude (deg),Longitude (deg)",
     "Forward (m/s),Speed Port/Stbd (m/s)", "Forward (m/s),Velocity Stbd/Port (m/s)", "Forward (m/s),Left-Right (m/s)"],
)  # fmt: skip
def test_names_that_could_mean_something_else_are_left_to_the_user(tmp_path: Path, header: str) -> None:
    folder = write_csv(tmp_path / "dive", nav=timed(header + "\n" + ",".join("1" for _ in header.split(","))))

    (topic,) = open_reader(folder).topics()

    assert topic.type == ""
    assert topic.problem.startswith("its columns match no sensor")


def test_velocities_along_beams_are_named_as_such(tmp_path: Path) -> None:
    beams = ",".join(f"Beam{k} Velocity [m/s]" for k in range(1, 5))
    (topic,) = open_reader(write_csv(tmp_path, dvl_beams=timed(f"{beams}\n1,1,1,1"))).topics()

    assert topic.problem.startswith("its velocities are along beams (Time [s], Beam1")


def test_columns_of_the_configuration_come_before_the_names(tmp_path: Path) -> None:
    columns = '[compass]\ntopic = "/dive"\nconvention = "ENU"\n'
    columns += 'columns = { time_unix_s = "Time [s]", heading = "Heading (deg)" }'

    log = logged_csv(tmp_path, columns, dive=WIDE)

    assert [p.topic for p in log.provenance.values()] == ["/dive/dvl", "/dive", "/dive/depth"]
    np.testing.assert_array_equal(log.tables["compass"]["heading_deg"], [59.5, 58.5])


@pytest.mark.parametrize(
    ("name", "label", "dimension", "factor"),
    [
        ("DVL X [m/s]", "DVL X", "velocity", 1.0),
        ("Speed(km/h)", "Speed", "velocity", 1 / 3.6),
        ("vx_mm_s", "vx", "velocity", 1e-3),
        ("forward_mps", "forward", "velocity", 1.0),
        ("Heading (°)", "Heading", "angle", 1.0),
        ("lat [1e-7 deg]", "lat", "angle", 1e-7),
        ("stamp_ns", "stamp", "time", 1),
        ("velocity[0]", "velocity[0]", None, 1.0),
        ("velocity[0] [ft/s]", "velocity[0]", "velocity", 0.3048),
        ("s", "s", None, 1.0),
        ("bottom.velocity_mm_s[0]", "bottom.velocity[0]", "velocity", 1e-3),
        ("velocity_cm_s.x", "velocity.x", "velocity", 1e-2),
        ("depth [fathom]", "depth", None, 1.0),
        ("Heading (0.01 deg)", "Heading", "angle", 0.01),
        ("Heading [mrad]", "Heading", "angle", 0.18 / np.pi),
        ("yawDeg", "yaw", "angle", 1.0),
        ("heading_deg_true", "heading", "angle", 1.0),
        ("dvl.fwd.mps", "dvl.fwd", "velocity", 1.0),
        ("header.stamp.sec", "header.stamp.sec", None, 1.0),
        ("euler.psi", "euler.psi", None, 1.0),
    ],
)
def test_the_unit_of_a_name_is_found(name: str, label: str, dimension: str | None, factor: float) -> None:
    found = named_unit(name)

    assert (found.label, found.dimension, found.factor) == (label, dimension, pytest.approx(factor, rel=1e-12))


def test_a_file_that_is_named_for_the_truth_is_no_sensor(tmp_path: Path) -> None:
    files = dict.fromkeys(("ground_truth", "gnss"), "stamp_ns,x_north_m,y_east_m\n1,2,3")

    types = {topic.name: topic.type for topic in open_reader(write_csv(tmp_path / "dive", **files)).topics()}

    assert types == {"/ground_truth": "", "/gnss": "usbldr/gps"}


HALF_PAST = "2026-05-18T12:30:00.000000"
ISO_OF = {  # the first of some cells -> the same in the notation of ISO
    ("18.05.2026 12:30:00,5", "18.05.2026 12:30:01"): "2026-05-18T12:30:00.500000",
    ("05/06/2026 1:30",): "2026-05-06T01:30:00.000000",
    ("05/06/2026 1:30", "13/06/2026 1:30"): "2026-06-05T01:30:00.000000",
    ("18-May-2026 12:30:00.25 UTC",): "2026-05-18T12:30:00.250000",
    ("12:30:00.5 18.05.2026",): "2026-05-18T12:30:00.500000",
    ("18.05.2026 12:30:00:200",): "2026-05-18T12:30:00.200000",
    ("20260518T143000.25+02",): "2026-05-18T12:30:00.250000",
    ("20260518-12:30:00.5",): "2026-05-18T12:30:00.500000",
    ("1 févr. 2026 12:30",): "2026-02-01T12:30:00.000000",
    ("8. März 2026 12:30",): "2026-03-08T12:30:00.000000",
    ("Fri May  8 12:30:00 2026",): "2026-05-08T12:30:00.000000",
    ("2026-05-18T14:30:00+02:00[Europe/Oslo]",): "2026-05-18T14:30:00+02:00",
    ("18.05.2026 24:00:01.5",): "2026-05-19T00:00:01.500000",
    ("1 day, 0:00:01.5",): "1970-01-02T00:00:01.500000",
    ("0 days 00:00:01.5",): "1970-01-01 00:00:01.5",
    **{(text,): text for text in ("Mon May 18 12:30:00 CEST 2026", "2026-05-18T14:30:00[Europe/Oslo]", "May 18")},
    **{(text,): HALF_PAST for text in (
        "05/18/2026 12:30:00 PM", "18.05.2026 14:30:00 +02:00", "12:30:00 PM, 05/18/26", "May 18, 2026 12:30:00 PM",
        "20260518_123000", "2026-05-18_12:30:00", "18. Mai 2026 12:30:00", "Montag, 18. Mai 2026 12:30:00",
        "18-mai-2026 12:30:00", "18 de mayo de 2026 12:30:00", "Mon, 18 May 2026 14:30:00 +0200",
        "Mon May 18 12:30:00 2026", "Mo, 18.05.2026 12:30:00", "Mon May 18 12:30:00 UTC 2026",
        "Monday, May 18, 2026 12:30:00 PM", "18.Mai.2026 12:30:00", "18.Mai.26 12:30:00",
    )},
}  # fmt: skip


@pytest.mark.parametrize("cells", ISO_OF)
def test_dates_and_times_of_other_notations_are_those_of_iso(cells: tuple[str, ...]) -> None:
    assert next(iter(with_iso_times({"t": cells})["t"])) == ISO_OF[cells]


DIGITS = {"TIME": ["000012.5", "123000"]}
IN_A_DAY = ["2026-05-18T00:00:12.500000", HALF_PAST]
OVER_MIDNIGHT = ["1970-01-01T23:59:59.500000", "1970-01-02T00:00:00.500000"]
TWICE = [f"2025-10-26 {at}:00" for at in ("02:59", "02:00", "02:59", "03:00")]
BESIDE = {  # columns, and which of them become what
    "digits beside digits": ({"DATE": ["20260518"] * 2} | DIGITS, {"TIME": IN_A_DAY}),
    "those of NMEA": ({"DATE": ["180526"] * 2, "UTC": DIGITS["TIME"]}, {"UTC": IN_A_DAY}),
    "without a zero": ({"DATE": ["10526", ""], "UTC": ["000012", "000013"]},
                       {"UTC": ["2026-05-01T00:00:12.000000", "000013"]}),
    "seconds beside minutes": ({"Date": ["18.05.2026"] * 2, "Time": ["23:59", "0:00"], "Sec": ["59.5", "1"]},
                               {"Time": ["2026-05-18T23:59:59.500000", "2026-05-18T00:00:01.000000"]}),
    "hours, minutes and seconds beside a date":
        ({"Date": ["18.05.2026"], "UTC h": ["12"], "UTC min": ["30"], "UTC s": ["0.5"]},
         {"UTC s": ["2026-05-18T12:30:00.500000"]}),
    "hours, minutes and seconds without one":
        ({"Hour": ["23", "0"], "Min": ["59", "0"], "Sec": ["59.5", "0.5"]}, {"Sec": OVER_MIDNIGHT}),
    "a year and a day of it beside times of day": ({"Year": ["2026"], "Jday": ["138"], "Time": ["12:30:00"]},
                                                   {"Jday": ["2026-05-18T00:00:00.000000"], "Time": [HALF_PAST]}),
    "year, month and day beside times of day":
        ({"Y": ["1"], "Year": ["2026"], "Month": ["5"], "Day": ["18"], "UTC": ["12:30:00"]},
         {"Day": ["2026-05-18T00:00:00.000000"], "UTC": [HALF_PAST]}),
    "a week and its seconds":
        ({"Week": ["2419"], "Seconds": ["131418.5"]}, {"Seconds": ["2026-05-18T12:30:00.500000"]}),
    "digits alone": ({"TIME": ["000012.5"]}, {}),
    "digits of a count": ({"count": ["20260518"], "TIME": ["000012.5"]}, {}),
    "an hour that comes twice":
        ({"t (Europe/Oslo)": TWICE},
         {"t (Europe/Oslo)": [f"2025-10-26T{at}:00.000000" for at in ("00:59", "01:00", "01:59", "02:00")]}),
    "midnight is passed": ({"t": ["23:59:59.5", "00:00:00.5"]}, {"t": OVER_MIDNIGHT}),
}  # fmt: skip


@pytest.mark.parametrize("case", BESIDE)
def test_times_are_read_with_the_date_beside_them(case: str) -> None:
    cells, changed = BESIDE[case]

    assert with_iso_times(cells) == cells | changed


def test_times_are_read_by_a_stated_format() -> None:
    read = with_iso_times({"t": ["05/06/2026 1:30"]}, {"t": "%d/%m/%Y %H:%M"})

    assert read == {"t": ["2026-06-05T01:30:00.000000"]}


@given(st.datetimes(datetime(1990, 1, 1), datetime(2050, 1, 1)))
def test_times_in_several_columns_are_those_of_the_calendar(moment: datetime) -> None:
    second = f"{moment.second + moment.microsecond / 1e6:.6f}"
    start = moment.replace(hour=0, minute=0, second=0, microsecond=0)
    numbered = dict(zip(("Year", "Month", "Day", "Hour", "Min"), moment.timetuple(), strict=False))
    of_day = f"{(moment - start).total_seconds():.6f}"
    since_1970 = round((moment - datetime(1970, 1, 1)).total_seconds() * 1e6)
    for parts in (
        {**numbered, "Sec": second},
        {"Year": moment.year, "Julian Day": moment.timetuple().tm_yday, "Seconds of day [s]": of_day},
        {**dict(zip(("YR", "MO", "DA", "HH", "MM"), [moment.year - 2000, *moment.timetuple()[1:]], strict=False))}
        | {"SS": second}
        if moment.year >= 2000
        else {**numbered, "Sec": second},
        {"header.stamp.nanosec": since_1970 % 10**6 * 1000, "header.stamp.sec": since_1970 // 10**6},
    ):
        *_, text = with_iso_times({name: [str(value)] for name, value in parts.items()}).values()
        assert text == [moment.isoformat(timespec="microseconds")]


@given(st.integers(0, 10**6 - 1), st.integers(0, 10**9 - 1), st.sampled_from(["ms", "milli", "micro", "nano"]))
def test_a_column_of_parts_of_seconds_adds_to_the_whole_ones_before_it(second: int, ns: int, unit: str) -> None:
    size_ns = {"ms": 10**6, "milli": 10**6, "micro": 1000, "nano": 1}[unit]
    moment = datetime(2026, 1, 1) + timedelta(seconds=second)
    since_1970 = (moment - datetime(1970, 1, 1)) // timedelta(seconds=1)
    part, wanted = unit if unit == "ms" else f"{unit}second", f".{ns // size_ns * size_ns:09d}"
    for text in (f"{moment}", f"{moment:%d.%m.%Y %H:%M:%S}", f"{since_1970}"):
        time, _ = with_iso_times({"t": [text], part: [str(ns // size_ns)]}).values()
        whole = str(since_1970) if text.isdigit() else f"{moment}" if "-" in text else moment.isoformat()
        assert time == [whole + wanted]
    assert with_iso_times({"t": [f"{moment}.5"], part: ["7"]})["t"] == [f"{moment}.5"]


SIDED = (
    *("{d:.0f} {m:.9f} {s}", "{d:.0f}-{w:.0f}-{r:.7f}{s}", "{s}{d:.0f}°{m:.9f}'", "{d:.0f}°{w:.0f}'{r:.7f}\"{s}"),
    *("{s} {a:.11f}", "{a:.11f}{s}"),
)


@given(st.floats(-180.0, 180.0), st.sampled_from(SIDED))
def test_angles_with_a_side_are_those_of_their_sign(angle_deg: float, form: str) -> None:
    degrees, part = divmod(abs(angle_deg), 1.0)
    minutes, rest = divmod(60 * part, 1.0)
    side = "W" if angle_deg < 0 else "E"
    text = form.format(d=degrees, m=60 * part, w=minutes, r=60 * rest, a=abs(angle_deg), s=side)
    read = numbers([text, ""], "lon")
    assert (dict(read.faults), read.values[0]) == ({}, pytest.approx(angle_deg, abs=1e-9))


@pytest.mark.parametrize("text", ["5E", "12 30", "N5S", "-5 N", "5 61 N", "5°N 3'", "north", "1.2 m"])
def test_what_is_no_angle_is_no_number(text: str) -> None:
    assert numbers([text], "lat").faults


def test_a_time_of_day_in_digits_is_known_by_its_minutes(tmp_path: Path) -> None:
    clocks = [(datetime(1970, 1, 1, 23, 59) + timedelta(seconds=k)).strftime("%H%M%S.000") for k in range(120)]
    seconds = [f"{100000 + k}.000" for k in range(120)]
    sheets = ["utc,hdg_deg\n" + "".join(f"{time},30\n" for time in times) for times in (clocks, seconds, clocks[:60])]

    log = logged_csv(tmp_path, "", compass=sheets[0] + "x,30\n")

    assert log.tables["compass"]["time_s"].tolist() == list(range(120))
    for sheet in sheets[1:]:  # of less than a minute either could be meant
        assert "a column utc without a known unit" in refusal(LogError, logged_csv, tmp_path, "", compass=sheet)


DATES = "".join(f"05/06/2026 01:30:{k:02d},30\n" for k in range(5))
WHEN = '[compass]\ncolumns = { time_unix_s = "when", time_format = "%d/%m/%Y %H:%M:%S", heading = "hdg" }'
ORDER = "05/06/2026 is read as 2026-06-05, and not as 2026-05-06: a name"


@pytest.mark.parametrize(
    ("toml", "sheet", "start", "said"),
    [
        (WHEN, f"when,hdg\n{DATES}", "2026-06-05T01:30:00", ""),
        ("", "Datum;Uhrzeit;Heading [deg]\n18.05.2026;12:00:00,5;1,5\n", "2026-05-18T12:00:00.5", ""),
        ("", f"Time,Heading\ndd/mm/yyyy HH:MM:SS,deg\n{DATES}", "2026-06-05T01:30:00", ORDER),
    ],
    ids=["of a configured format", "in two columns of other names", "of a format in the line of units"],
)
def test_dates_are_times_in_a_column_of_any_name_and_of_a_stated_format(tmp_path, toml, sheet, start, said):
    log = logged_csv(tmp_path, toml, compass=sheet)

    assert log.start_ns == pd.Timestamp(start).value
    assert said in codes(log).get("DATE-ORDER", "")


@given(text=st.text("abcx/:-", min_size=1, max_size=20).filter(lambda text: text[:2] != "//"), row=st.integers(0, 3))
@settings(max_examples=15)
def test_the_cell_that_stops_a_file_is_named(text: str, row: int) -> None:
    times = ["2020-09-13T12:26:40", "2020-09-13T12:26:41", "2020-09-13T12:26:42", "2020-09-13T12:26:43"]
    times[row] = text
    with tempfile.TemporaryDirectory() as name:
        file = write_csv(Path(name) / "dive", usbl="time,lat_deg,lon_deg\n" + "".join(f"{t},45,7\n" for t in times))
        log = open_reader(file)
        (topic,) = log.topics()
        if not topic.problem:
            read_whole(log, {"/usbl": ["lat_deg"]})
        said = topic.problem + "".join(finding.text for finding in log.findings())

    assert f'"{text}"' in said
    assert "time" in said
    assert ("first row" in said) == (row == 0)
    assert row == 0 or f"line {row + 2}" in said


@pytest.mark.parametrize(
    ("dates", "notation", "first", "code"),
    [
        (("11/05/2026", "12/05/2026"), "", "2026-05-11", "DATE-ORDER"),
        (("05/11/2026", "05/12/2026"), "", "2026-05-11", "DATE-ORDER"),
        (("11/05/2026", "11/05/2026"), "", "2026-11-05", "DATE-AMBIGUOUS"),
        (("11/05/2026", "11/05/2026"), " (dd/mm/yyyy)", "2026-05-11", "DATE-ORDER"),
        (("11.05.2026", "11.05.2026"), " [MM.DD.YYYY]", "2026-11-05", "DATE-ORDER"),
        (("11.05.2026", "11.05.2026"), "", "2026-05-11", "DATE-ORDER"),
        (("05/05/2026", "05/05/2026"), "", "2026-05-05", ""),
        (("12/05/2026", "13/05/2026"), "", "2026-05-12", ""),
    ],
)
def test_all_files_take_the_same_order_of_day_and_month(tmp_path, dates, notation, first, code):
    clocks = ("23:59", "00:00") if dates[0] != dates[1] else ("23:58", "23:59")
    before, behind = ([f"{d} {c}:{k:02d}" for k in range(30)] for d, c in zip(dates, clocks, strict=True))
    gps = "Time,Latitude [deg],Longitude [deg]\n" + "".join(f"{time},45,7\n" for time in before)
    compass = f"Time{notation},Heading [deg]\n" + "".join(f"{t},{k}\n" for k, t in enumerate((*before, *behind)))
    log = logged_csv(tmp_path, "", gps=gps, compass=compass)

    assert log.start_ns == pd.Timestamp(f"{first}T{clocks[0]}").value
    assert set(log.tables) == {"gps", "compass"}
    assert [found for found in codes(log) if found.startswith("DATE")] == [code][: len(code)]


def test_a_date_without_a_time_of_day_is_not_asked_about(tmp_path: Path) -> None:
    rows = "\n".join(f"{k},05/06/2026" for k in range(5))

    found = codes(logged_csv(tmp_path, "", compass=timed(f"Heading [deg],Calibrated\n{rows}")))

    assert not [code for code in found if code.startswith("DATE")]


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252"])
@pytest.mark.parametrize("separator", [",", ";"])
def test_names_in_windows_1252_are_named_in_the_configuration(tmp_path: Path, encoding: str, separator: str) -> None:
    file = saved(tmp_path / "a.csv", f"Zeit [s],Länge [°]\n{T},35\n".replace(",", separator).encode(encoding))

    log = read_as(file, '[compass]\ncolumns = { time_unix_s = "Zeit", heading = "Länge [°]" }\n')

    assert log.tables["compass"]["heading_deg"].tolist() == [35.0]
