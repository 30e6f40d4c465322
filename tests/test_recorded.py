"""Reading recorded tracks: round trips, conversions, recognised names, and one sentence for each refusal."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from jink.envs.estimates_file import write_estimates
from jink.envs.reading.columns import parse_columns
from jink.envs.reading.geodesy import Origin, earth_fixed, to_local
from jink.envs.recorded import read_tracks
from jink.estimators.sensors import make_sensor
from jink.estimators.tracks import Tracks

finite = st.floats(-1e9, 1e9, allow_nan=False)
cell = st.one_of(st.just(np.nan), finite)
name = st.text("abcXYZ019-_ é", min_size=1, max_size=6).map(lambda s: f"n{s}".strip())


@st.composite
def frames(draw):
    """Interleaved tracks in the track format, times sorted within each."""
    names = draw(st.lists(name, min_size=1, max_size=3, unique=True))
    rows = draw(st.lists(st.tuples(st.sampled_from(names), cell, cell, cell), min_size=1, max_size=12))
    steps = draw(st.lists(st.floats(0, 1e3), min_size=len(rows), max_size=len(rows)))
    frame = pd.DataFrame(rows, columns=["track", "x", "y", "z"])
    frame.insert(1, "t", np.cumsum(steps) - 500.0)
    frame["sigma_x"] = draw(st.floats(1e-6, 1e6))
    frame["sigma_y"] = 2.0
    frame["sigma_z"] = 3.0
    frame["true_x"], frame["true_y"], frame["true_z"] = frame["x"] + 1, 0.5, -1.25
    frame["intent"] = draw(st.sampled_from(["turn", "straight", "NA"]))
    return frame


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(frame=frames())
def test_what_is_written_is_what_is_read(tmp_path, suffix, frame):
    path = tmp_path / f"a.{suffix}"
    frame.to_csv(path, index=False) if suffix == "csv" else frame.to_parquet(path, index=False)
    tracks = read_tracks(path)
    assert tracks.axes == 3 and tracks.sensor == "position"
    assert tracks.ids == tuple(frame["track"].unique())
    for track in tracks:
        part = frame[frame["track"] == track.id]
        # Text and Parquet both carry float64 exactly, so equality is exact, NaN for NaN.
        np.testing.assert_array_equal(track.times, part["t"])
        np.testing.assert_array_equal(track.measurements, part[["x", "y", "z"]])
        np.testing.assert_array_equal(track.truth, part[["true_x", "true_y", "true_z"]])
        assert track.intents.tolist() == part["intent"].tolist()
        missing = part[["x", "y", "z"]].isna().to_numpy()
        sigma = part[["sigma_x", "sigma_y", "sigma_z"]].to_numpy()
        expected = np.where(missing, 1.0, sigma**2)[:, :, None] * np.eye(3)
        np.testing.assert_array_equal(track.noise, expected)


def write(path: Path, text: str | bytes) -> Path:
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@pytest.mark.parametrize(
    ("content", "options", "sentence"),
    [
        ("", {}, r"a\.csv must have a header and data rows; got an empty file\."),
        ("t,x,y\n", {}, r"must have data rows; got a header only\."),
        ("t,x,y", {}, r"must have data rows; got a header only\."),
        (b"\x89PNG\0\0\1\2", {}, r"must be CSV text \(UTF-8\) or Parquet; got binary data\."),
        ("t,x,y,µ\n0,1,2,3\n".encode("latin-1"), {}, r"got bytes that are not UTF-8\. Save it as UTF-8\."),
        (b"PAR1 but cut off", {}, r"must be a whole Parquet file; got damage"),
        ("0,1,2\n1,2,3\n", {}, r"must have a header line; got numbers in its first line"),
        ("t,x,x,y\n0,1,2,3\n", {}, r"must name each column once; got x more than once\."),
        ("t,x,y\n0,1,2\n\n1,oops,2\n", {}, r"row 2 \(line 4\), column 'x' must be a finite .*got 'oops'"),
        ("t,x,y\n0,1,2\n1,2,inf\n", {}, r"row 2 \(line 3\), column 'y' must be a finite number.*got inf"),
        ("t,x,y\n0,1,2\n,2,2\n", {}, r"row 2 \(line 3\), column 't' must be a time .*got an empty cell"),
        ("t,x,y\n2020-01-01T00:00:00,1,2\nlater,2,2\n", {}, r"row 2 .*column 't' must be a time.*'later'"),
        ("t,x,y\n1,1,2\n0.5,2,2\n", {}, r"row 2 .*'t' must not go backwards .*0\.5 after 1, 1 such.*--sort"),
        ("t,x,y\n0,1,2\n1,2\n", {}, r"row 2 \(line 3\), .*all 3 columns and no more; got a row of 2 cells"),
        ("t,x,y\n0,1,2\n1,2,3,4\n", {}, r"row 2 \(line 3\), .*got a row of 4 cells"),
        ("t,x,y,sigma_x,sigma_y\n0,1,2,1,1\n0,1,2,1,-3\n", {}, r"row 2 .*'sigma_y' must be a standard.*-3"),
        ("t,x,y,sigma_x,sigma_y\n0,1,2,1,\n", {}, r"row 1 .*'sigma_y' must be a standard.*got an empty cell"),
        ("t,x,y,sigma_x\n0,1,2,1\n", {}, r"must have all of sigma_x, sigma_y or none; got only sigma_x"),
        ("t,lat,lon\n0,91,2\n", {}, r"row 1 .*'lat' must lie within -90\.\.90 degrees; got 91"),
        ("t,lat,lon\n0,,\n", {}, r"must have a row with latitude and longitude; got none"),
        ("t,bearing\n0,120\n", {}, r"'bearing' must lie within one turn, .*got 120\.0\. Use degrees=True"),
        ("t,track,x,y\n0,,1,2\n", {}, r"row 1 .*'track' must name the track; got an empty cell"),
        ("t,range,sensor_x,sensor_y\n0,5,,1\n", {}, r"'sensor_x' must say where the sensor is; got an empty"),
        ("a,b,c\n0,1,2\n", {}, r"must have a time column; got columns a, b, c\. .*--columns t="),
        ("t,b,c\n0,1,2\n", {}, r"must have a position .*got columns t, b, c\. .*--columns t="),
        ("t,bearing,range_rate\n0,1,2\n", {}, r"one sensor measures.*not bearing-rate.*range_rate="),
        ("t,x,y,range\n0,1,2,3\n", {}, r"must have one kind of measurement.*--columns range=range"),
        ("t,x,y,track,icao24\n0,1,2,3,a\n", {}, r"one column for track, not track and icao24.*track=icao24"),
        ("t,x,y,alt,gps_alt\n0,1,2,3,4\n", {"axes": 3}, r"one column for z, not alt and gps_alt"),
        ("t,X,x_m,Y\n0,1,2,3\n", {"columns": {"x": "Z", "y": "Y"}}, r"must have the column 'Z' mapped to x"),
        ("t,x,y\n0,1,2\n", {"axes": 3}, r"must have a height column for three axes.*--columns z=COLUMN"),
        ("t,x,y\n0,1,2\n", {"axes": 4}, r"axes must be 2, 3 or None; got 4"),
        ("t,x,y\n0,1,2\n", {"columns": {"q": "x"}}, r"columns must use the track format's names; got 'q'"),
        ("t,x,y\n0,1,2\n", {"columns": {"x": "x"}}, r"must have both x and y"),
        ("t,x,y\n0,1,2\n", {"where": {"ok": "1"}}, r"must have the column 'ok' to filter by"),
        ("t,x,y,ok\n0,1,2,0\n", {"where": {"ok": "1"}}, r"must have rows where ok=1; got none"),
        ("t,x,y\n0,1,2\n", {"height": 1.0}, r"height must be left out unless"),
        ("t,x,y\n0,1,2\n", {"bias": {"range": 1.0}}, r"bias must give .*x, y; got range=1\.0"),
        ("t,x,y\n0,1,2\n", {"rate_hz": 0.0}, r"rate_hz must be > 0 and finite; got 0\.0"),
        (
            "t,range,sensor_x,sensor_y,sensor_z\n0,9,0,0,2\n",
            {"axes": 2},
            r"must be read with axes=3, or with",
        ),
        ("t,x,y,true_x\n0,1,2,3\n", {}, r"must have all of true_x, true_y or none"),
    ],
)
def test_a_bad_file_is_refused_with_one_sentence(tmp_path, content, options, sentence):
    path = write(tmp_path / "a.csv", content)
    with pytest.raises(ValueError, match=sentence) as refusal:
        read_tracks(path, **options)
    assert str(refusal.value).startswith(("read_tracks: ", "parse_columns: "))
    assert "\n" not in str(refusal.value) and str(tmp_path) not in str(refusal.value)


def test_paths_that_are_no_files(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"must name an existing file; got .*nowhere\.csv"):
        read_tracks(tmp_path / "nowhere.csv")
    with pytest.raises(IsADirectoryError, match="must name a file; got the folder"):
        read_tracks(tmp_path)


def test_repeated_and_textual_parquet_columns_are_refused(tmp_path):
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table([pa.array([0.0])] * 4, names=["t", "x", "y", "y"]), path)
    with pytest.raises(ValueError, match="must name each column once; got y more than once"):
        read_tracks(path)
    pd.DataFrame({"t": [0.0, 1.0], "x": ["1", "two"], "y": [1, 2]}).to_parquet(path)
    with pytest.raises(ValueError, match=r"a\.parquet, row 2, column 'x' must be a finite number.*'two'"):
        read_tracks(path)
    pd.DataFrame({"t": [0.0], "x": [pd.Timestamp(0)], "y": [1]}).to_parquet(path)
    with pytest.raises(ValueError, match=r"must hold numbers in column 'x'; got timestamp"):
        read_tracks(path)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(junk=st.one_of(st.binary(max_size=80), st.text('t,xy01\n"#;.-e\r\t ', max_size=60).map(str.encode)))
def test_junk_is_read_or_refused_but_never_crashes(tmp_path, junk):
    path = write(tmp_path / "junk.csv", b"t,x,y\n" + junk)
    try:
        tracks = read_tracks(path)
    except ValueError as refusal:
        assert "\n" not in str(refusal)
    else:
        assert np.isfinite(tracks.times).all() and not np.isinf(tracks.measurements).any()


@settings(max_examples=100, deadline=None)
@given(pairs=st.dictionaries(st.sampled_from(["t", "x", "lat", "sigma_x"]), st.text("abc ()_", max_size=5)))
def test_column_mappings_survive_text(pairs):
    pairs = {ours: column.strip() for ours, column in pairs.items()}
    assert parse_columns(" , ".join(f"{ours} = {column}" for ours, column in pairs.items())) == pairs


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("t=a,time", r"must be pairs like t=time,x=east; got 'time'"),
        ("sigma_ranges=a", r"names; got 'sigma_ranges'\. Did you mean sigma_range\?"),
        ("t=a,t=b", r"must give each name once; got 't' twice"),
    ],
)
def test_bad_column_mappings(text, sentence):
    with pytest.raises(ValueError, match=sentence):
        parse_columns(text)


def test_padding_order_and_interleaving(tmp_path):
    path = write(tmp_path / "a.csv", "track,t,x,y\nb,1,10,11\na,0,1,2\nb,2,20,21\nb,2,30,31\n007,5,,\n")
    tracks = read_tracks(path)
    assert tracks.ids == ("b", "a", "007") and tracks.lengths.tolist() == [3, 1, 1]
    np.testing.assert_array_equal(tracks.times, [[1, 2, 2], [0, 0, 0], [5, 5, 5]])
    np.testing.assert_array_equal(tracks.measurements[0], [[10, 11], [20, 21], [30, 31]])
    assert np.isnan(tracks.measurements[1, 1:]).all() and np.isnan(tracks.measurements[2]).all()
    few = tracks.subset(["007", "a"])
    assert few.ids == ("007", "a") and few.times.shape == (2, 1)
    assert tracks.subset(np.array([False, True, False])).ids == ("a",)
    with pytest.raises(ValueError, match="must name tracks; got 'c'"):
        tracks.subset(["c"])


def test_sort_repeats_and_filters(tmp_path):
    path = write(tmp_path / "a.csv", "t,x,y,new\n2,5,6,1\n0,1,2,1\n1,1,2,0\n")
    tracks = read_tracks(path, sort=True)
    np.testing.assert_array_equal(tracks.times, [[0, 1, 2]])
    np.testing.assert_array_equal(tracks.measurements[0], [[1, 2], [1, 2], [5, 6]])
    np.testing.assert_array_equal(read_tracks(path, sort=True, drop_repeats=True).times, [[0, 2]])
    np.testing.assert_array_equal(read_tracks(path, sort=True, where={"new": "1.0"}).times, [[0, 2]])
    two = write(tmp_path / "b.csv", "track,t,x,y\na,0,1,2\na,1,1,2\nb,2,1,2\n")
    assert read_tracks(two, drop_repeats=True).lengths.tolist() == [1, 1]
    np.testing.assert_array_equal(read_tracks(path, rate_hz=4).times, [[0, 0.25, 0.5]])


@pytest.mark.parametrize(
    "content",
    [
        b"\xef\xbb\xbft;x;y\r\n0;1;2\r\n1;3;4\r\n",
        b"t\tx\ty\n0\t1\t2\n1\t3\t4",
        b"# made by hand\n# t,x,y  (x, in m)\n0,1,2\n\n1,3,4\n\n",
        b"# a remark\nTime (s), East ,NORTH\n0, 1,2\n1,3 ,4\n",
        b'"t","x","y"\n"0","1","2"\n"1","3","4"\n',
        b"t,x,y\n1970-01-01 00:00:00,1,2\n1970-01-01T02:00:01.000+02:00,3,4\n",
    ],
)
def test_dialects_give_the_same_tracks(tmp_path, content):
    tracks = read_tracks(write(tmp_path / "a.csv", content))
    np.testing.assert_array_equal(tracks.times, [[0, 1]])
    np.testing.assert_array_equal(tracks.measurements, [[[1, 2], [3, 4]]])


def test_timestamps_of_parquet_are_epoch_seconds(tmp_path):
    path = tmp_path / "a.parquet"
    times = pd.to_datetime(["2020-01-01T00:00:00.25", "2020-01-01T00:00:01.00"])
    pd.DataFrame({"t": times, "x": [1, 2], "y": [3, 4]}).to_parquet(path)
    np.testing.assert_array_equal(read_tracks(path).times, [[1577836800.25, 1577836801.0]])


def test_mapping_beats_recognition_and_can_switch_a_column_off(tmp_path):
    path = write(tmp_path / "a.csv", "t,x,y,east,north,label,id\n0,1,2,3,4,turn,a\n1,1,2,3,4,turn,b\n")
    assert read_tracks(path).measurements[:, 0].tolist() == [[1, 2], [1, 2]]
    tracks = read_tracks(path, parse_columns("x=north,y=east,track=,intent="))
    assert tracks.measurements.tolist() == [[[4, 3], [4, 3]]] and tracks.intents is None and tracks.ids == ("a",)
    assert tracks.notes[0] == "columns: t=t, x=north, y=east"


def test_third_axis_is_asked_for(tmp_path):
    path = write(tmp_path / "a.csv", "t,east,north,alt_m\n0,1,2,3\n")
    assert read_tracks(path).axes == 2
    assert read_tracks(path, axes=3).measurements.tolist() == [[[1, 2, 3]]]
    assert read_tracks(path, {"z": "alt_m"}).measurements.tolist() == [[[1, 2, 3]]]
    path = write(tmp_path / "b.csv", "t,x,y,z\n0,1,2,3\n")
    assert read_tracks(path).axes == 3 and read_tracks(path, axes=2).measurements.tolist() == [[[1, 2]]]


def test_polar_rows_carry_the_sensor_and_turn_to_the_mathematical_bearing(tmp_path):
    path = write(
        tmp_path / "a.csv",
        "t,range,bearing,range_rate,sensor_x,sensor_y,sensor_vx,sensor_vy,sigma_range,sigma_bearing,"
        "sigma_range_rate\n0,100,30,-5,1,2,3,4,10,2,0.5\n1,,250,,5,6,7,8,10,1,0.5\n",
    )
    tracks = read_tracks(path, degrees=True, compass=True, bias={"range": 1.5})
    assert tracks.sensor == "range-bearing-rate" and tracks.axes == 2
    # 30 degrees from north, clockwise, is 60 from east; 250 is -160.
    np.testing.assert_allclose(tracks.measurements[0, 0], [98.5, np.deg2rad(60), -5], rtol=1e-12)
    np.testing.assert_allclose(tracks.measurements[0, 1], [np.nan, np.deg2rad(-160), np.nan], rtol=1e-12)
    np.testing.assert_array_equal(tracks.sensor_states[0], [[1, 2, 3, 4], [5, 6, 7, 8]])
    np.testing.assert_allclose(np.diag(tracks.noise[0, 0]), [100, np.deg2rad(2) ** 2, 0.25], rtol=1e-12)


@pytest.mark.parametrize(
    ("header", "axes", "kind"),
    [
        ("x,y", 2, "position"),
        ("range", 2, "range"),
        ("bearing", 2, "bearing"),
        ("range,range_rate", 2, "range-range-rate"),
        ("range,bearing", 2, "range-bearing"),
        ("bearing,elevation", 3, "bearing-elevation"),
        ("range,bearing,elevation,range_rate", 3, "range-bearing-elevation-rate"),
    ],
)
def test_every_kind_the_reader_names_is_a_sensor_of_as_many_components(tmp_path, header, axes, kind):
    cells = ",".join("1" for _ in header.split(","))
    tracks = read_tracks(write(tmp_path / "a.csv", f"t,{header}\n0,{cells}\n"))
    sensor = make_sensor(tracks.sensor)
    assert (tracks.sensor, tracks.axes) == (kind, axes)
    assert (sensor.size, sensor.axes) == (tracks.measurements.shape[2], axes)


def test_slant_ranges_come_down_to_the_plane(tmp_path):
    path = write(tmp_path / "a.csv", "t,anchor,ax,ay,az,range,sigma_range\n0,A,1,2,5,5,0.4\n1,B,3,4,5,2.9,0.4\n")
    slant = read_tracks(path)
    assert slant.axes == 3 and slant.sensor_states[0, 0].tolist() == [1, 2, 5, 0, 0, 0]
    flat = read_tracks(path, axes=2, height=2.0)
    # 3-4-5 triangle; the sigma grows by 5/4. The second range is shorter than the height difference.
    np.testing.assert_allclose(flat.measurements[0, :, 0], [4.0, np.nan], rtol=1e-12)
    np.testing.assert_allclose(flat.noise[0, 0], [[0.25]], rtol=1e-12)
    assert flat.sensor_ids.tolist() == [["A", "B"]] and flat.sensor_states.shape == (1, 2, 4)


def test_degrees_become_local_metres(tmp_path):
    path = write(tmp_path / "a.csv", "t,lat,lon,alt\n0,45,7,100\n1,45.001,7,100\n2,45,7.001,110\n3,45,7.001,\n4,,,1\n")
    tracks = read_tracks(path, {"alt": "alt"})
    # Lengths of 0.001 degree at latitude 45 (WGS84, at 100 m): 111.1338 m north, 78.8480 m east; 1 mm covers
    # the curvature over 110 m.
    expected = [[0, 0, 0], [0, 111.1338, 0], [78.8480, 0, 10], [78.8468, 0, np.nan]]
    np.testing.assert_allclose(tracks.measurements[0, :4], expected, atol=2e-3)
    assert np.isnan(tracks.measurements[0, 4, :2]).all()


@given(
    latitude=st.floats(-89, 89),
    longitude=st.floats(-180, 180),
    altitude=st.floats(-100, 1e4),
    step=st.floats(-1, 1),
)
def test_local_metres_keep_distances(latitude, longitude, altitude, step):
    origin = Origin(latitude, longitude, altitude)
    points = [np.array([latitude, latitude + step]), np.array([longitude, longitude - step])]
    local = to_local(*points, np.array([altitude, altitude + 5]), origin)
    np.testing.assert_allclose(local[0], 0, atol=1e-8)
    chord = np.diff(earth_fixed(*points, np.array([altitude, altitude + 5])), axis=0)
    # A rotation: relative to 6 400 km, rounding is about a nanometre.
    np.testing.assert_allclose(np.linalg.norm(local[1] - local[0]), np.linalg.norm(chord), atol=1e-6)


def test_truth_is_interpolated_and_never_extrapolated(tmp_path):
    fixes = write(tmp_path / "a.csv", "t,x,y\n0,0,0\n1,0,0\n2.5,0,0\n9,0,0\n")
    truth = write(tmp_path / "b.csv", "t,late,x,y,vx,vy\n1,2,10,0,1,-1\n2,,,,,\n3,4,30,-4,3,-1\n")
    tracks = read_tracks(fixes, truth=truth)
    expected = [[np.nan, np.nan], [10, 0], [25, -3], [np.nan, np.nan]]
    np.testing.assert_allclose(tracks.truth[0], expected, rtol=1e-12)
    np.testing.assert_allclose(tracks.truth_velocity[0, 2], [2.5, -1], rtol=1e-12)
    write(truth, "t,late,x,y\n1,2,10,0\n3,4,30,-4\n")
    shifted = read_tracks(fixes, truth=truth, truth_columns={"t": "late"})
    np.testing.assert_allclose(shifted.truth[0, 2], [15, -1], rtol=1e-12)
    assert shifted.truth_velocity is None


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("t,x,y\n20,0,0\n30,0,0\n", r"must cover measurement times, 0\.\.1 s; got 20\.\.30 s"),
        ("t,track,x,y\n0,q,0,0\n0,r,0,0\n", r"must hold true positions of the measured tracks, named alike"),
        ("t,lat,lon\n0,1,1\n1,1,1\n", r"must use the frame of the measurements, metres; got degrees"),
        ("t,x,y\n1,0,0\n0,0,0\n", r"b\.csv, row 2 .*'t' must not go backwards"),
        ("t,range\n1,0\n", r"must hold true positions"),
        ("a,b\n1,0\n", r"must have a time column.*--truth-columns"),
    ],
)
def test_bad_truth_files(tmp_path, content, sentence):
    fixes = write(tmp_path / "a.csv", "t,track,x,y\n0,p,0,0\n1,p,0,0\n")
    with pytest.raises(ValueError, match=sentence):
        read_tracks(fixes, truth=write(tmp_path / "b.csv", content))


def test_truth_matches_tracks_by_name(tmp_path):
    fixes = write(tmp_path / "a.csv", "t,track,x,y\n0,p,0,0\n0,q,0,0\n")
    truth = write(tmp_path / "b.csv", "t,track,x,y\n0,q,5,6\n0,r,7,8\n")
    tracks = read_tracks(fixes, truth=truth)
    np.testing.assert_array_equal(tracks.truth[:, 0], [[np.nan, np.nan], [5, 6]])


def test_estimates_are_written_and_read_back(tmp_path):
    rng = np.random.default_rng(1)
    tracks = Tracks.from_arrays([np.ones((3, 2)), np.ones((1, 2))], [np.arange(3.0), np.zeros(1)], ids=["p", "q"])
    cov = np.broadcast_to(np.diag([1.0, 4.0, 9.0, 16.0]), (2, 3, 4, 4))
    estimates = SimpleNamespace(
        position=rng.normal(size=(2, 3, 2)),
        velocity=rng.normal(size=(2, 3, 2)),
        covariance=cov,
        mode_probs=np.broadcast_to([0.25, 0.75], (2, 3, 2)),
        nis=np.ones((2, 3)),
        status=np.array([[4, 0, 2], [1, 0, 0]], dtype=np.int8),
    )
    for suffix, read in (("csv", pd.read_csv), ("parquet", pd.read_parquet)):
        path = tmp_path / f"out.{suffix}"
        write_estimates(path, tracks, estimates, ["straight", "turn"])
        frame = read(path)
        head = ["track", "t", "x", "y", "vx", "vy", "sd_x", "sd_y", "sd_vx", "sd_vy", "nis", "status"]
        assert frame.columns.tolist() == [*head, "mode_straight", "mode_turn"]
        assert frame["track"].tolist() == ["p", "p", "p", "q"]
        assert frame["status"].tolist() == ["starting", "ok", "missing", "repaired"]
        assert frame.loc[0, ["sd_x", "sd_y", "sd_vx", "sd_vy"]].tolist() == [1, 2, 3, 4]
        np.testing.assert_array_equal(read_tracks(path).measurements[0], estimates.position[0])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out.csv", "out.parquet"]
    with pytest.raises(ValueError, match=r"path must end in \.csv or \.parquet; got out\.txt"):
        write_estimates(tmp_path / "out.txt", tracks, estimates)
    with pytest.raises(ValueError, match="path must lie in an existing folder"):
        write_estimates(tmp_path / "no" / "out.csv", tracks, estimates)
    with pytest.raises(ValueError, match="modes must have 2 names; got 1"):
        write_estimates(path, tracks, estimates, ["straight"])
    with pytest.raises(ValueError, match=r"must have positions of shape \(1, 3, 2\)"):
        write_estimates(path, tracks.subset([0]), estimates)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"times": [[0.0, -1.0]]}, r"times must not go backwards; got -1\.0 after 0\.0 in track 'a', row 1"),
        ({"times": [[0.0, np.nan]]}, "times must be finite"),
        ({"times": [0.0, 1.0]}, r"times must have shape \(B, T\)"),
        ({"measurements": [[[0.0, np.inf], [1, 1]]]}, "measurements must be finite or NaN"),
        ({"measurements": np.zeros((1, 3, 2))}, r"measurements must have shape \(B, T, D\) = \(1, 2, D\)"),
        ({"measurements": np.zeros((1, 2, 3))}, "must have D = 2 components"),
        ({"noise": np.zeros((1, 2, 2))}, r"noise must have shape \(1, 2, 2, 2\)"),
        ({"lengths": [3]}, r"lengths must lie in 0\.\.2"),
        ({"ids": ("a", "a")}, "ids must be 1 different names"),
        ({"axes": 5}, "axes must be 1, 2 or 3"),
    ],
)
def test_tracks_refuse_what_does_not_fit(change, sentence):
    good = {"ids": ("a",), "times": [[0.0, 1.0]], "measurements": np.zeros((1, 2, 2)), "sensor": "position"}
    good |= {"lengths": [2], "axes": 2}
    assert len(Tracks(**good)) == 1
    with pytest.raises(ValueError, match=sentence):
        Tracks(**(good | change))


def test_tracks_from_one_a_batch_and_a_list():
    one = Tracks.from_arrays(np.zeros((4, 2)), np.arange(4), noise=np.eye(2))
    assert one.measurements.shape == (1, 4, 2) and one.noise.shape == (1, 4, 2, 2) and one.ids == ("1",)
    batch = Tracks.from_arrays(np.zeros((3, 4, 2)), np.arange(4))
    assert batch.times.shape == (3, 4) and len(batch) == 3
    ragged = Tracks.from_arrays(
        [np.zeros((2, 1)), np.ones((3, 1))],
        [[0, 1], [0, 1, 2]],
        sensor="range",
        intents=[["turn", "straight"], ["a", "b", "c"]],
        sensor_states=[np.ones((2, 4)), np.ones((3, 4))],
    )
    assert ragged.lengths.tolist() == [2, 3] and ragged.axes == 2
    assert np.isnan(ragged.measurements[0, 2]).all() and ragged.intents[0].tolist() == [
        "turn",
        "straight",
        "",
    ]
    assert [len(track.times) for track in ragged] == [2, 3]
    with pytest.raises(ValueError, match="times must have one entry per measurement row"):
        Tracks.from_arrays(np.zeros((4, 2)), np.arange(3))


RECORDED = [
    ("aircraft_adsb/noisy_takeoff.csv", {"columns": {"z": "alt_m"}}, ("position", 1, 730, 3)),
    ("aircraft_adsb/noisy_landing.csv", {"where": {"fresh": "1"}}, ("position", 1, 681, 2)),
    ("gliders_igc/napret.csv", {"columns": {"z": "gps_alt"}}, ("position", 1, 5380, 3)),
    ("stonesoup_demos/OpenSky_Plane_States.csv", {}, ("position", 84, 120, 2)),
    ("stonesoup_demos/SolentAIS_20160112_130211.csv", {}, ("position", 91, 1138, 2)),
    ("stonesoup_demos/UAV_Rot.csv", {"axes": 3}, ("position", 1, 965, 3)),
    ("bus_gnss/bus304_limerick.csv", {}, ("position", 1, 2144, 2)),
    ("dancing_bees/seq4_labelled.csv", {"rate_hz": 30.0}, ("position", 1, 757, 2)),
    ("plaza_range/plaza1_ranges.csv", {"sort": True}, ("range", 1, 3529, 2)),
    ("uwb_outdoor/los_B_case3_ranges.csv", {}, ("range", 1, 6645, 3)),
    (
        "rockets/prometheus_telemega.csv",
        {"columns": {"alt": "gps_altitude"}, "where": {"gps_new": "1"}},
        ("position", 1, 239, 3),
    ),
]


@pytest.mark.parametrize(("file", "options", "expected"), RECORDED)
def test_recorded_files_are_read(data_dir, file, options, expected):
    tracks = read_tracks(data_dir / file, **options)
    assert (tracks.sensor, *tracks.times.shape, tracks.axes) == expected
    assert np.isfinite(tracks.measurements[tracks.used]).any(axis=-1).all()


def test_two_exports_of_one_flight_agree(data_dir):
    geographic = read_tracks(data_dir / "stonesoup_demos/UAV_Rot.csv")
    metres = read_tracks(data_dir / "stonesoup_demos/UAV_Rot_enu.csv")
    # The other export multiplied degrees by a fixed length: 1 % of a kilometre.
    assert np.abs(geographic.measurements - metres.measurements).max() < 10.0
    np.testing.assert_allclose(geographic.times - geographic.times[:, :1], metres.times, atol=1e-6)


def test_recorded_errors_are_those_of_the_source(data_dir):
    folder = data_dir / "uwb_outdoor"
    fixes = read_tracks(
        folder / "los_B_case3_lsq_position.csv",
        axes=2,
        truth=folder / "los_B_case3_truth.csv",
        truth_columns={"t": "time_aligned"},
    )
    # Walking at 1 m/s with 0.2 s of lag would show as 0.2 m; the clean fixes are within 0.21 m.
    assert np.nanmedian(np.linalg.norm(fixes.measurements - fixes.truth, axis=-1)) < 0.25
    folder = data_dir / "plaza_range"
    ranges = read_tracks(folder / "plaza1_ranges.csv", sort=True, truth=folder / "plaza1_truth.csv")
    error = ranges.measurements[0, :, 0] - np.linalg.norm(ranges.truth[0] - ranges.sensor_states[0, :, :2], axis=1)
    # The source gives a bias of 2.8 m and a robust sigma of 1.2 m.
    assert abs(np.nanmedian(error) - 2.8) < 0.1
    assert abs(1.4826 * np.nanmedian(np.abs(error - np.nanmedian(error))) - 1.2) < 0.1
