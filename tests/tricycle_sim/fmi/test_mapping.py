"""Mapping files, and what does not fit an FMU: one line each."""

import zipfile

import pytest

from tricycle_core.errors import PlantError
from tricycle_sim.fmi.mapping import load_mapping
from tricycle_sim.vehicle import load_vehicle

VEHICLE = load_vehicle()

fmpy = pytest.importorskip("fmpy")


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("- 1", "must hold entries"),
        ("fmu: a\ninputs: {}\noutputs: {}\nstepp: 1", "stepp: unknown; did you mean step"),
        (
            "fmu: a\noutputs: {}\ninputs: {speeed: v}",
            r"inputs\.speeed: unknown; did you mean speed",
        ),
        ("fmu: a\ninputs: {}\noutputs: {speed: v}", r"outputs\.speed: unknown"),
        ("fmu: a\ninputs: {}\noutputs: {}\nstep: 0", "step: 0 must be positive"),
        ("fmu: a\ninputs: {}\noutputs: {x: {variable: x, scale: 0}}", "scale: 0 must be finite"),
        (
            "fmu: a\ninputs: {}\noutputs: {heading: {variable: psi, scael: -1}}",
            r"outputs\.heading\.scael: unknown; did you mean scale",
        ),
        ("inputs: {}\noutputs: {}", "lacks `fmu`"),
        (
            "fmu: a\ninputs: {}\noutputs: {x: {variable: x, scale: big}}",
            r"outputs\.x\.scale: needs a number, not a text",
        ),
        (
            "fmu: a\ninputs: {}\noutputs: {}\nstart_values: {mass: big}",
            r"start_values\.mass: needs true or false or a number, not a text",
        ),
    ],
)
def test_a_wrong_mapping_is_one_line(tmp_path, text, line):
    path = tmp_path / "mapping.yaml"
    path.write_text(text)
    with pytest.raises(PlantError, match=line) as problem:
        load_mapping(path)
    assert "\n" not in str(problem.value)


def test_a_mapping_that_is_not_there_is_one_line():
    from tricycle_sim.plants.installed import plant_by_name

    with pytest.raises(PlantError, match=r"^plant 'fmu': none\.yaml: No such file"):
        plant_by_name("fmu:none.yaml", VEHICLE)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"outputs": {"x": "xx"}}, "no variable 'xx'; did you mean x"),
        ({"outputs": {"x": "mass"}}, r"outputs\.x: mass is parameter, needs output or local"),
        ({"inputs": {"speed": "vx"}}, r"inputs\.speed: vx is output, needs input"),
        ({"outputs": {"heading": {"variable": "x"}}}, "x is in m, needs rad or deg"),
        ({"outputs": {"x": {"variable": "x", "unit": "mm"}}}, "has x in m, not mm"),
        ({"parameters": {"yaw_inertia": "mass"}}, "mass is in kg, needs kg m"),
        ({"start_values": {"masss": 1.0}}, "no variable 'masss'; did you mean mass"),
        ({"fmu": "none.fmu"}, "there is no such FMU"),
    ],
)
def test_what_the_fmu_lacks_is_one_line(mapping_file, changes, line):
    from tricycle_sim.fmi.cosimulation import Fmu
    from tricycle_sim.vehicle import load_vehicle

    vehicle = load_vehicle()
    mapping = load_mapping(mapping_file(**changes))
    units = {n: vehicle.unit(n) for n in mapping.parameters if n in vehicle.values}
    with pytest.raises(PlantError, match=line) as problem:
        Fmu(mapping, units)
    assert "\n" not in str(problem.value)


def test_a_file_that_is_no_fmu_is_one_line(tmp_path):
    from tricycle_sim.fmi.cosimulation import Fmu

    (tmp_path / "a.fmu").write_text("no archive")
    (tmp_path / "m.yaml").write_text("fmu: a.fmu\ninputs: {}\noutputs: {}")
    with pytest.raises(PlantError, match=r"a\.fmu: is not an FMU"):
        Fmu(load_mapping(tmp_path / "m.yaml"))


@pytest.mark.parametrize(
    ("name", "description", "line"),
    [
        ("model.xml", "<fmiModelDescription/>", r"it has no modelDescription\.xml$"),
        ("modelDescription.xml", "<fmiModelDescription/>", "names no fmiVersion$"),
        ("modelDescription.xml", "no XML", "is not an FMU: "),
    ],
)
def test_an_archive_that_is_no_fmu_is_one_line(tmp_path, name, description, line):
    from tricycle_sim.fmi.cosimulation import Fmu

    with zipfile.ZipFile(tmp_path / "a.fmu", "w") as archive:
        archive.writestr(name, description)
    (tmp_path / "m.yaml").write_text("fmu: a.fmu\ninputs: {}\noutputs: {}")
    with pytest.raises(PlantError, match=line) as problem:
        Fmu(load_mapping(tmp_path / "m.yaml"))
    assert "\n" not in str(problem.value)


def test_an_fmu_of_fmi_1_is_one_line(tmp_path):
    from tricycle_sim.fmi.cosimulation import Fmu

    with zipfile.ZipFile(tmp_path / "a.fmu", "w") as archive:
        archive.writestr(
            "modelDescription.xml",
            '<fmiModelDescription fmiVersion="1.0" modelName="a" modelIdentifier="a" guid="a" '
            'numberOfContinuousStates="0" numberOfEventIndicators="0"><Implementation>'
            "<CoSimulation_StandAlone><Capabilities/></CoSimulation_StandAlone></Implementation>"
            "<ModelVariables/></fmiModelDescription>",
        )
    (tmp_path / "m.yaml").write_text("fmu: a.fmu\ninputs: {}\noutputs: {}")
    with pytest.raises(
        PlantError, match=r"a\.fmu: needs an FMU 2\.0 or 3\.0; this one is of FMI 1"
    ):
        Fmu(load_mapping(tmp_path / "m.yaml"))


@pytest.mark.parametrize(
    ("version", "needed"), [("2.0", fmpy.platform), ("3.0", fmpy.platform_tuple)]
)
def test_an_fmu_without_a_binary_for_this_platform_says_which_it_has(
    tmp_path, monkeypatch, version, needed
):
    from tricycle_sim.fmi.cosimulation import Fmu

    unpacked = tmp_path / "unpacked"
    unpacked.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(unpacked))
    with zipfile.ZipFile(tmp_path / "a.fmu", "w") as archive:
        archive.writestr(
            "modelDescription.xml",
            f'<fmiModelDescription fmiVersion="{version}" modelName="a" guid="a" '
            'instantiationToken="a"><CoSimulation modelIdentifier="car"/><ModelVariables/>'
            "<ModelStructure/></fmiModelDescription>",
        )
        archive.writestr("binaries/other/car.lib", "")
    (tmp_path / "m.yaml").write_text("fmu: a.fmu\ninputs: {}\noutputs: {}")
    with pytest.raises(PlantError, match=rf"{needed}/car\.\w+; it has: other/car\.lib$"):
        Fmu(load_mapping(tmp_path / "m.yaml"))
    assert not list(unpacked.iterdir())


@pytest.mark.slow
def test_a_start_value_that_is_no_number_is_one_line_and_leaves_nothing(
    mapping_file, tmp_path, monkeypatch
):
    from tricycle_sim.plants.installed import plant_by_name

    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    file = mapping_file(start_values={"slewed": float("inf")})
    with pytest.raises(PlantError, match=r"tricycle\.fmu: refuses slewed = inf"):
        plant_by_name(f"fmu:{file}", VEHICLE)
    assert not list(tmp_path.glob("fmu-*"))


@pytest.mark.slow
def test_units_and_scales_are_those_of_the_mapping(mapping_file):
    from tricycle_sim.fmi.cosimulation import Fmu

    plain = Fmu(load_mapping(mapping_file()))
    turned = Fmu(
        load_mapping(mapping_file(inputs={"speed": {"variable": "speed_setpoint", "scale": -2.0}}))
    )
    speeds = []
    for fmu, wanted in ((plain, 1.0), (turned, -2.0)):
        instance = fmu.start()
        for _ in range(200):
            instance.set(speed=wanted)
            instance.advance()
        speeds.append(instance.read()["vx"])
        instance.close()
        fmu.close()
    assert speeds[0] == speeds[1] != 0.0
