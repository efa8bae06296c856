"""``usbldr locate``: where each photo, ping or sample of a dive was taken, and how sure that is."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import escape

import click

from usbldr.filters.errors import UsageError, listed, printable
from usbldr_cli.options.completion import LOG
from usbldr_cli.options.output_files import refuse_file, write_file
from usbldr_cli.options.verbosity import verbose_option

if TYPE_CHECKING:
    import pandas as pd

ENDINGS = (".csv", ".geojson", ".kml", ".parquet")
PATH, NEW_FOLDER = click.Path(path_type=Path), click.Path(path_type=Path, file_okay=False)
ANGLE = click.FloatRange(0, 170, min_open=True)
LEVER_ARM = "Place of the sensor on the vehicle: metres starboard, forward, up.  [default: 0 0 0]"
CLOCK = "How far the clock of these times is ahead, or the time that a photo of a clock shows.  [default: 0]"
OUTPUT = "NAME.csv, .geojson, .kml or .parquet.  [may be repeated; default: CSV to stdout]"
OPENING = "Opening angles in degrees of a camera that looks down: adds its footprint on the bottom."
GEOTAG = "Write copies of the photos with GPS tags into FOLDER; a sidecar (.xmp) if one is no JPEG."


@click.command()
@click.argument("run", type=PATH)
@click.option("--at", "place", metavar="FILE|TOPIC|FOLDER", required=True, help="Table of times, topic, or photos.")
@click.option("--log", type=LOG, help="Log of the topic of --at.  [default: that of RUN]")
@click.option("--lever-arm", "lever_m", type=float, nargs=3, default=(0.0,) * 3, metavar="S F U", help=LEVER_ARM)
@click.option("--clock", default="0", metavar="SECONDS|PHOTO=TIME", help=CLOCK)
@click.option("-o", "--output", type=PATH, multiple=True, metavar="FILE", help=OUTPUT)
@click.option("--opening-angle", "opening_deg", type=ANGLE, nargs=2, metavar="ACROSS ALONG", help=OPENING)
@click.option("--geotag", type=NEW_FOLDER, metavar="FOLDER", help=GEOTAG)
@click.option("--force", is_flag=True, help="Replace existing files.")
@verbose_option
def locate(
    run: Path,
    place: str,
    log: str | None,
    lever_m: tuple[float, float, float],
    clock: str,
    output: tuple[Path, ...],
    opening_deg: tuple[float, float] | None,
    geotag: Path | None,
    force: bool,
) -> None:
    """Give the position of each photo, ping or sample, from the smoothed run directory RUN.

    --at is a CSV table with a column time_ns, time_unix_s, time_s (of RUN's tables) or time (ISO 8601, UTC), a topic of
    RUN's log, or a folder of photos (EXIF). Each row gets position, depth, heading, roll, pitch and the radius that
    holds 95 % of the errors. A row outside RUN, in an outage or before the first fix is marked in the column note.

    \b
    $ usbldr replay dive.mcap --smooth -o dive-run
    $ usbldr locate dive-run --at photos --lever-arm 0 1.2 -0.3 -o photos.csv -o photos.kml
    """
    from usbldr.io.reading.sample_times import NAME, sample_times
    from usbldr.io.reports.geotags import Place, write_geotags
    from usbldr.io.reports.locate import OUTSIDE, located, read_smoothed_run
    from usbldr.io.writing import writing

    for file in output:
        if file.suffix.lower() not in ENDINGS:
            raise UsageError(f"{file}: choose a name that ends in {', '.join(ENDINGS)}")
        read = [path for path in (Path(place), run / "report.json") if path.exists()]
        refuse_file("--output", file, force, read)
    smoothed = read_smoothed_run(run)
    if geotag is not None and not Path(place).is_dir():
        raise UsageError("--geotag: --at is no folder of photos")
    if smoothed.origin is None and (geotag or any(file.suffix.lower() in (".geojson", ".kml") for file in output)):
        raise UsageError(f"{run} has no latitudes: state origin_lat_deg and origin_lon_deg under [map] and repeat it")
    time_ns, own, untimed = sample_times(place, Path(log) if log else smoothed.log, smoothed.start_ns, clock)
    if untimed:
        click.echo(f"usbldr: left out, without a time (EXIF DateTimeOriginal): {listed(untimed, 3)}", err=True)
    found = located(smoothed, time_ns, lever_m, opening_deg)
    if opening_deg is not None and not found["altitude_m"].notna().any():
        click.echo("usbldr: no footprint: the log has no altitude at these times (of its DVL)", err=True)
    found.insert(0, NAME, own.index.map(str))
    own = own.reset_index(drop=True).rename(columns={name: f"own_{name}" for name in own if name in found})
    table = found.join(own)
    if not output and geotag is None:
        click.echo(_text(".csv", table, ""), nl=False)
    for file in output:
        if file.suffix.lower() == ".parquet":
            with writing(file, "choose another file for --output"):
                table.to_parquet(file, engine="pyarrow", index=False)
        else:
            write_file("--output", file, _text(file.suffix.lower(), table, smoothed.folder.name))
        click.echo(f"{file}: written")
    if geotag is not None:
        known = table.loc[table["lat_deg"].notna(), [NAME, *Place._fields]]
        places = {Path(place) / name: Place(*where) for name, *where in known.itertuples(index=False)}
        copies, sidecars = write_geotags(geotag, places, force)
        click.echo(f"{geotag}: {copies} copies with GPS tags and {sidecars} sidecars written")
    outside = int((found["note"] == OUTSIDE).sum())
    if marked := int((found["note"] != "").sum()):
        text = f"outside the run and without a position: {outside}; with another note: {marked - outside}"
        click.echo(f"usbldr: of {len(found)} times, {text}", err=True)


def _text(form: str, table: "pd.DataFrame", title: str) -> str:
    """Return the located rows as CSV, or those with a position as points of RFC 7946 or as placemarks of KML."""
    from usbldr.io.reports.report_json import json_values
    from usbldr.io.reports.tracks import feature, geojson_pieces, kml_shape, kml_text, rounded

    if form == ".csv":
        text: str = rounded(table).to_csv(index=False, lineterminator="\n")
        return text
    rows = table[table["lat_deg"].notna()].to_dict("records")
    if form == ".geojson":
        return "".join(geojson_pieces(feature("Point", _place(one), json_values(one)) for one in rows))
    marks = [
        f"<Placemark><name>{escape(printable(str(one['name'])))}</name>"
        f"<description>{one['radius95_m']:.2f} m (95 %) {escape(one['note'])}</description>"
        f"{kml_shape('Point', [_place(one)])}</Placemark>\n"
        for one in rows
    ]
    return kml_text(title, "".join(marks))


def _place(one: "dict[Any, Any]") -> list[float]:
    """Return longitude, latitude and, if the depth is known, the height above the sea."""
    place = [round(one["lon_deg"], 9), round(one["lat_deg"], 9)]
    return [*place, round(-one["depth_m"], 4)] if math.isfinite(one["depth_m"]) else place
