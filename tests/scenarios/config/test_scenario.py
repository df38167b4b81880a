import hashlib
import json

import numpy as np
import pytest

from pickproof.cell.errors import InputError
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.scenarios.config.input_hashes import input_hashes
from pickproof.scenarios.config.scenario import (
    list_scenarios,
    load_scenario,
    scenario_hash,
    scenario_json,
    weights_hash,
    weights_used,
)
from pickproof.scenarios.picking.workcell import Workcell, check_inputs


def test_every_shipped_scenario_loads():
    for name in list_scenarios():
        assert load_scenario(name).name == name


def test_camera_looks_down_and_sees_the_whole_bin():
    s = load_scenario("bracket")
    T = s.camera.T_world_camera
    np.testing.assert_allclose(T[:3, 2], [0, 0, -1], atol=1e-12)
    lx, ly, lz = s.source_bin.inner
    x, y, z = s.source_bin.position
    corners = np.array([[x + i * lx / 2, y + j * ly / 2, z + lz, 1] for i in (-1, 1) for j in (-1, 1)])
    uv = s.camera.intrinsics.project((np.linalg.inv(T) @ corners.T).T[:, :3])
    assert (uv > 10).all() and (uv < np.array([s.camera.width, s.camera.height]) - 10).all()


def test_overrides_change_the_field_and_the_hash():
    plain, changed = load_scenario("bracket"), load_scenario("bracket", ["camera.width=1280", "sensor.enabled=false"])
    assert (changed.camera.width, changed.sensor.enabled) == (1280, False)
    assert scenario_hash(plain) != scenario_hash(changed)


def test_hash_is_that_of_the_effective_scenario_without_its_seed(tmp_path):
    minimal = tmp_path / "minimal.yaml"
    minimal.write_text("name: bracket\nworkpiece: bracket\ncarry: {speed_scale: 1.0, straight: 0.008}\n")
    a, b = load_scenario("bracket"), load_scenario(str(minimal))
    assert scenario_json(a) == scenario_json(b)
    assert scenario_hash(a) == scenario_hash(load_scenario("bracket", ["seed=5"]))


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("name: a\nworkpiece: bracket\ncount: many\n", ["count", "'many'"]),
        ("name: a\nworkpiece: bracket\ncount: 0\n", ["count", "0"]),
        ("name: a\nworkpiece: bracket\ncamera: {wide: 3}\n", ["camera.wide", "fov_deg"]),
        ("name: a\nworkpiece: no_such\n", ["workpiece", "no_such", "bracket"]),
        ("name: a\nworkpiece: bracket\nrobot: r2d2\n", ["robot", "r2d2", "lrmate200id"]),
        ("name: a\nworkpiece: bracket\nsource_bin: {inner: [1, 1, -1], position: [0, 0, 0]}\n", ["source_bin"]),
        ("name: [\n", ["line", "YAML"]),
        ("name: a\nworkpiece: bracket\ncount: 10:30\n", ["count", "'10:30'"]),  # 630 in YAML 1.1
        ("name: a\nworkpiece: bracket\ncount: 8\ncount: 9\n", ["line 4", "each field once"]),
        ("- a\n", ["mapping"]),
    ],
)
def test_bad_files_name_file_field_and_value(tmp_path, text, names):
    path = tmp_path / "cell.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load_scenario(str(path))
    for name in ["cell.yaml", *names]:
        assert name in str(caught.value)


@pytest.mark.parametrize(
    ("override", "names"),
    [
        ("camera.width", ["--set", "FIELD=VALUE"]),
        ("camera.width=[", ["camera.width", "YAML"]),
        ("count.more=3", ["count", "no fields"]),
        ("count=many", ["--set count=many", "count"]),
    ],
)
def test_bad_overrides(override, names):
    with pytest.raises(InputError) as caught:
        load_scenario("bracket", [override])
    for name in names:
        assert name in str(caught.value)


def test_unknown_scenario_lists_the_known():
    with pytest.raises(InputError, match=r"brackett.*one of: .*bracket"):
        load_scenario("brackett")
    with pytest.raises(InputError, match="missing file"):
        load_scenario("no/such.yaml")


def test_weights_hash(tmp_path, monkeypatch):
    (tmp_path / "thing").mkdir()
    (tmp_path / "thing" / "workpiece.yaml").touch()
    monkeypatch.setenv("PICKPROOF_WORKPIECES", str(tmp_path))
    assert weights_hash("thing") == ""
    (tmp_path / "thing" / "ps6d.safetensors").write_bytes(b"abc")
    # SHA-256 of "abc", FIPS 180-2 appendix B.1
    assert weights_hash("thing") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


def test_a_scenario_names_its_own_grasp_points(tmp_path, monkeypatch):
    """From the scenario's folder on in a file, from here on in --set; what the file holds enters the inputs' hash."""
    text = (load_workpiece("bracket").folder / "grasps.yaml").read_text(encoding="utf-8")
    table = tmp_path / "mine.yaml"
    table.write_text(text.replace("name: plate_from_top", "name: mine"), encoding="utf-8")
    file = tmp_path / "cell.yaml"
    file.write_text("name: cell\nworkpiece: bracket\ngrasps: mine.yaml\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    for scenario in (load_scenario(str(file)), load_scenario("bracket", ["grasps=mine.yaml"])):
        assert scenario.grasps == str(table)
        check_inputs(scenario, frozenset({"perception"}))
        cell = Workcell.build(scenario.model_copy(update={"count": 1}), 0)
        try:
            assert cell.grasps.points[0].name == "mine"
        finally:
            cell.close()
        before = input_hashes(scenario, ())
        assert before["grasps.yaml"] != input_hashes(load_scenario("bracket"), ())["grasps.yaml"]
        table.write_text(table.read_text(encoding="utf-8") + "\n", encoding="utf-8")
        assert input_hashes(scenario, ())["grasps.yaml"] != before["grasps.yaml"]
    with pytest.raises(InputError, match=r"none\.yaml.*missing file"):
        check_inputs(load_scenario("bracket", ["grasps=none.yaml"]), frozenset({"perception"}))


def test_hash_of_campaigns_older_than_the_method_stays():
    plain = load_scenario("bracket")
    assert plain.perception.method == "auto"
    assert scenario_hash(plain) == scenario_hash(load_scenario("bracket", ["perception.method=auto"]))
    assert scenario_hash(plain) != scenario_hash(load_scenario("bracket", ["perception.method=search"]))
    data = json.loads(scenario_json(plain))
    del data["seed"], data["perception"]["method"]
    older = hashlib.sha256(json.dumps(data, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
    assert scenario_hash(plain) == older


def test_weights_count_only_where_a_network_looks():
    assert weights_used(load_scenario("bracket"), frozenset()) == weights_hash("bracket") != ""
    assert weights_used(load_scenario("bracket", ["perception.method=search"]), frozenset()) == ""


def test_an_unknown_method_is_named():
    with pytest.raises(InputError) as error:
        load_scenario("bracket", ["perception.method=guess"])
    assert "perception.method" in str(error.value)
    assert "'search'" in str(error.value)
