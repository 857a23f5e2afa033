"""Launch files against the code: `launch` itself is not to be had here, so it is recorded.

Stand-ins for `launch` and `launch_ros` note what the launch files construct; that is compared with
the installed executables and, in tests/ros/test_parameters.py, with the parameters of the nodes.
"""

import pytest
from launch_recorder import LAUNCH_FILES, launch_actions, launched_nodes, project_scripts

from tricycle_core.errors import NodeError
from tricycle_core.start import ending_with_parent


@pytest.mark.parametrize("file", LAUNCH_FILES)
def test_every_executable_exists_in_its_package(file):
    scripts = project_scripts()
    for node in launched_nodes(file):
        assert scripts[node["executable"]].startswith(f"{node['package']}.")


@pytest.mark.parametrize("file", LAUNCH_FILES)
def test_a_killed_launch_leaves_no_node_behind(file):
    for node in launched_nodes(file, installed=["robot_state_publisher"]):
        assert node["prefix"].name == "launch-prefix"
        assert node["prefix"].default == " ".join(ending_with_parent())
        assert node["exec_name"] == node["executable"]


@pytest.mark.parametrize("file", ["simulation.launch.py", "vehicle.launch.py"])
def test_the_bridge_is_configured_once_it_is_up_and_activated_once_it_is_configured(file):
    on_configured, bridge, configure = (
        action
        for action in launch_actions(file)
        if action.keywords.get("executable", "tricycle_bridge") == "tricycle_bridge"
    )
    assert bridge.keywords["parameters"][-1] == {"autostart": False}
    CONFIGURE, ACTIVATE = 1, 3  # lifecycle_msgs/msg/Transition
    assert configure.keywords["event"].keywords == {
        "lifecycle_node_matcher": bridge,
        "transition_id": CONFIGURE,
    }
    (handler,) = on_configured.arguments
    assert handler.keywords["target_lifecycle_node"] is bridge
    assert (handler.keywords["start_state"], handler.keywords["goal_state"]) == (
        *("configuring", "inactive"),
    )
    (activate,) = handler.keywords["entities"]
    assert activate.keywords["event"].keywords["transition_id"] == ACTIVATE


@pytest.mark.parametrize("file", ["simulation.launch.py", "vehicle.launch.py"])
def test_without_autostart_the_bridge_is_left_to_another_manager(file):
    actions = launch_actions(file, autostart="false")
    assert all("executable" in action.keywords for action in actions)


def test_a_namespace_has_its_own_clock_diagnostics_transforms_and_ports():
    alone = launched_nodes("simulation.launch.py")
    second = launched_nodes("simulation.launch.py", namespace="/second/")
    assert all(node["namespace"] == "" and node["remappings"] == [] for node in alone)
    for node in second:
        assert node["namespace"] == "second"
        assert node["remappings"] == [
            *(("/clock", "clock"), ("/diagnostics", "diagnostics")),
            *(("/tf", "tf"), ("/tf_static", "tf_static")),
        ]

    def ports(nodes):
        return {
            node["executable"]: (node["parameters"]["steer_port"], node["parameters"]["drive_port"])
            for node in nodes
            if "steer_port" in node["parameters"]
        }

    assert ports(alone)["tricycle_sim"] == ports(alone)["tricycle_bridge"]
    assert ports(second)["tricycle_sim"] == ports(second)["tricycle_bridge"]
    assert set(ports(alone).values()).isdisjoint(ports(second).values())


def test_quality_of_service_of_the_parameter_file_holds_in_a_namespace():
    (driver,) = (
        node["parameters"]
        for node in launched_nodes("simulation.launch.py", namespace="second")
        if node["executable"] == "maneuver_driver"
    )
    odom = "qos_overrides./second/odom.subscription"  # a parameter has the topic's full name
    assert (driver[f"{odom}.reliability"], driver[f"{odom}.depth"]) == ("reliable", 1)


@pytest.mark.parametrize("file", ["simulation.launch.py", "vehicle.launch.py"])
def test_the_model_is_published_where_robot_state_publisher_is_installed(file):
    nodes = launched_nodes(file, installed=["robot_state_publisher"])
    (publisher,) = (n for n in nodes if n["executable"] == "robot_state_publisher")
    assert publisher["parameters"]["robot_description"].startswith("<?xml")


def test_a_simulation_starts_every_node_of_a_drive():
    executables = {node["executable"] for node in launched_nodes("simulation.launch.py")}
    assert executables == {
        *("tricycle_sim", "tricycle_bridge", "excitation_planner"),
        *("maneuver_driver", "trajectory_recorder"),
    }


def test_the_monitor_is_started_where_it_is_asked_for_and_compares_with_the_plan():
    nodes = launched_nodes("vehicle.launch.py", identification="true", plan_file="mine.json")
    (monitor,) = (node for node in nodes if node["executable"] == "identification_monitor")
    assert monitor["parameters"]["plan_file"] == "mine.json"


@pytest.mark.parametrize("bag", ["first", ""])
def test_a_drive_is_not_started_unrecorded_where_a_bag_was_asked_for(bag):
    # the recorder may have ended, because the bag exists for example
    nodes = launched_nodes("vehicle.launch.py", bag=bag)
    found = {node["executable"]: node["parameters"] for node in nodes}
    assert found["trajectory_recorder"]["record"] is bool(bag)
    assert found["maneuver_driver"]["recording_needed"] is bool(bag)


def test_hold_to_run_countdown_and_bring_up_are_launch_arguments_that_are_off_unless_given():
    def parameters(**arguments):
        nodes = launched_nodes("vehicle.launch.py", **arguments)
        found = {node["executable"]: node["parameters"] for node in nodes}
        driver, bridge = found["maneuver_driver"], found["tricycle_bridge"]
        return [of.get(n) for of, n in (
            (driver, "hold_timeout"), (driver, "countdown"), (bridge, "bring_up_record"),
        )]  # fmt: skip

    assert parameters() == [None, None, None]
    given = {"hold_timeout": "0.25", "countdown": "5", "bring_up_record": "bring_up.json"}
    assert parameters(**given) == [0.25, 5.0, "bring_up.json"]


@pytest.mark.parametrize("file", ["simulation.launch.py", "vehicle.launch.py"])
def test_a_parameter_file_reaches_the_nodes_and_their_topics_in_a_namespace(file, tmp_path):
    own = tmp_path / "own.yaml"
    own.write_text(
        "/**/maneuver_driver:\n  ros__parameters:\n    max_deviation: 1.5\n"
        "    qos_overrides: {/odom: {subscription: {depth: 7}}}\n"
        "/**/tricycle_bridge:\n  ros__parameters: {bring_up_age: 7.0}\n"
    )
    nodes = launched_nodes(file, params_file=str(own), namespace="second")
    found = {node["executable"]: node["parameters"] for node in nodes}
    driver = found["maneuver_driver"]
    assert driver["max_deviation"] == 1.5
    assert driver["qos_overrides./second/odom.subscription.depth"] == 7
    assert found["tricycle_bridge"]["bring_up_age"] == 7.0


def test_a_parameter_file_that_contradicts_the_arguments_or_is_none_is_told(tmp_path):
    own = tmp_path / "own.yaml"
    own.write_text("maneuver_driver:\n  ros__parameters: {hold_timeout: 0.5}\n")
    assert launched_nodes("vehicle.launch.py", params_file=str(own))
    twice = "hold_timeout of maneuver_driver: set by a launch argument"
    with pytest.raises(NodeError, match=twice):
        launched_nodes("vehicle.launch.py", params_file=str(own), hold_timeout="0.25")
    with pytest.raises(NodeError, match=r"none\.yaml: No such file"):
        launched_nodes("vehicle.launch.py", params_file=str(tmp_path / "none.yaml"))


@pytest.mark.parametrize(
    "text",
    [
        "second: {maneuver_driver: {ros__parameters: {hold_timeout: 0.5}}}",
        "/second: {/inner: {maneuver_driver: {ros__parameters: {hold_timeout: 0.5}}}}",
        "/**: {ros__parameters: {hold_timeout: 0.5}}",
        "/second/*: {ros__parameters: {hold_timeout: 0.5}}",
    ],
)
def test_what_a_file_sets_in_a_namespace_is_seen_too(tmp_path, text):
    own = tmp_path / "own.yaml"
    own.write_text(text)
    with pytest.raises(NodeError, match="hold_timeout of maneuver_driver: set by a launch"):
        launched_nodes("vehicle.launch.py", params_file=str(own), hold_timeout="0.25")


def test_quality_of_service_may_be_written_in_one_name_and_in_a_namespace(tmp_path):
    own = tmp_path / "own.yaml"
    own.write_text(
        "second:\n  maneuver_driver:\n    ros__parameters:\n"
        "      qos_overrides./odom.subscription.depth: 7\n"
    )
    nodes = launched_nodes("vehicle.launch.py", params_file=str(own), namespace="second")
    (driver,) = (node["parameters"] for node in nodes if node["executable"] == "maneuver_driver")
    assert driver["qos_overrides./second/odom.subscription.depth"] == 7


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("", r"is nothing, must be a mapping as `/\*\*/maneuver_driver: "),
        ("# all of it commented out\n", "is nothing, must be a mapping"),
        ("- a", r"is \['a'\], must be a mapping"),
        ("maneuver_driver: 3", "maneuver_driver: is 3, must be a mapping"),
        ("maneuver_driver:", "maneuver_driver: is nothing, must be a mapping"),
        ("maneuver_driver: {hold_timeout: 0.5}", "maneuver_driver/hold_timeout: is 0.5, must be"),
        (
            "maneuver_driver: {ros__parameters: [1]}",
            r"maneuver_driver: ros__parameters is \[1\], must be",
        ),
        ("ros__parameters: {hold_timeout: 0.5}", "ros__parameters: must be below the name"),
        ("3: {ros__parameters: x}", "3: ros__parameters is 'x', must be a mapping of names"),
    ],
)
def test_a_parameter_file_that_is_no_mapping_is_told_in_one_line(tmp_path, text, fault):
    own = tmp_path / "own.yaml"
    own.write_text(text)
    with pytest.raises(NodeError, match=rf"own\.yaml: {fault}") as caught:
        launched_nodes("vehicle.launch.py", params_file=str(own))
    assert "\n" not in str(caught.value)


def test_the_vehicle_never_starts_the_simulation_nor_arms_by_itself():
    nodes = launched_nodes("vehicle.launch.py", odom_topic="/localization/odometry")
    assert "tricycle_sim" not in {node["executable"] for node in nodes}
    (bridge,) = (node for node in nodes if node["executable"] == "tricycle_bridge")
    assert bridge["parameters"]["arm_on_activate"] is False
    assert bridge["parameters"]["use_sim_time"] is False
    assert all(("odom", "/localization/odometry") in node["remappings"] for node in nodes)


def test_a_given_vehicle_file_reaches_bridge_and_simulation(tmp_path):
    from importlib.resources import files

    text = (files("tricycle_sim") / "tricycle.yaml").read_text()
    assert "value: 0.335" in text
    file = tmp_path / "other.yaml"
    file.write_text(text.replace("value: 0.335", "value: 0.345", 1))
    nodes = {
        node["executable"]: node["parameters"]
        for node in launched_nodes("simulation.launch.py", vehicle_file=str(file))
    }
    assert nodes["tricycle_bridge"]["tyre_radius"] == 0.345
    assert nodes["tricycle_sim"]["vehicle_file"] == str(file)


@pytest.mark.parametrize("file", LAUNCH_FILES)
def test_no_parameter_is_set_twice(file):
    # a file's entry for a node would win over the launch file's: see docs
    for node in launched_nodes(file):
        assert not node["twice"], node["executable"]


@pytest.mark.parametrize(
    ("file", "argument", "wanted"),
    [
        ("simulation.launch.py", {"true_seed": "first"}, "true_seed:=first: needs a whole number"),
        ("vehicle.launch.py", {"payload": "heavy"}, "payload:=heavy: needs a number"),
        (
            "vehicle.launch.py",
            {"identification": "yes"},
            "identification:=yes: needs true or false",
        ),
        ("replay.launch.py", {"loop": "1"}, "loop:=1: needs true or false"),
    ],
)
def test_a_wrong_value_is_told_with_its_argument(file, argument, wanted):
    with pytest.raises(ValueError, match=f"^{wanted}$"):
        launch_actions(file, **argument)


def test_a_misspelt_argument_is_told(caplog):
    launch_actions("vehicle.launch.py", argv=["vehicle_flie:=car.yaml", "bag:=b", "others:=1"])
    assert caplog.messages == ["vehicle_flie is not a launch argument: did you mean vehicle_file?"]


def test_values_of_a_replay_have_the_types_of_the_replayers_parameters():
    given = {"rate": "2", "topics": "/odom, /imu", "paused": "True"}
    (node,) = launched_nodes("replay.launch.py", bag="b", **given)
    fixed = {"start": 0.0, "duration": 0.0, "exclude": [""], "loop": False, "clock": True}
    assert node["parameters"] == {
        **fixed, "bag": "b", "rate": 2.0, "topics": ["/odom", "/imu"], "paused": True,
    }  # fmt: skip
