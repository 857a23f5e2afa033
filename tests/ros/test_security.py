"""The SROS2 policy allows what each node of the vehicle does, and nothing that none of them do."""

from fnmatch import fnmatchcase
from pathlib import Path
from pkgutil import resolve_name
from xml.etree import ElementTree

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from launch_recorder import NODES, launched_nodes

from tricycle_cli.operation.monitor_node import Monitor
from tricycle_cli.operation.operator_node import Operator

pytestmark = pytest.mark.ros

FOLDER = Path(__file__).parents[2] / "deploy" / "sros2"
OF_VEHICLE = [name for name in NODES if name not in ("tricycle_sim", "bag_replayer")]


def rules(profile, name):
    """Topics and services of a profile, absolute: kind of rule -> names."""
    found = {"publish": set(), "subscribe": set(), "reply": set(), "request": set()}
    for group in [*profile.findall("topics"), *profile.findall("services")]:
        for kind in found.keys() & group.keys():
            found[kind] |= {
                entry.text.replace("~", f"/{name}") if entry.text[0] in "~/" else f"/{entry.text}"
                for entry in group
            }
    return found


def _profile(enclave, node):
    policy = ElementTree.parse(FOLDER / "tricycle.policy.xml")
    (profile,) = policy.iterfind(
        f"enclaves/enclave[@path='{enclave}']/profiles/profile[@node='{node}']"
    )
    return profile


def allowed(name, node=None):
    """What every node may, and what a node in the enclave of this name may besides."""
    node = node or name
    common = rules(ElementTree.parse(FOLDER / "node.xml").getroot(), node)
    return common, rules(_profile(f"/tricycle/{name}", node), node)


@pytest.mark.parametrize("name", OF_VEHICLE)
def test_the_policy_is_what_the_node_does(ros_environment, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    # where tf2_msgs is installed, the driver publishes a transform: here any message stands for it
    monkeypatch.setattr("excitation_planner.maneuver_driver_node.TFMessage", DiagnosticArray)
    # a lifecycle node announces its changes once it has a transition event to send
    rclpy.init(args=["--ros-args", "-p", "autostart:=false"])
    node = resolve_name(NODES[name])()
    try:
        does = {
            "publish": node.get_publisher_names_and_types_by_node(name, "/"),
            "subscribe": node.get_subscriber_names_and_types_by_node(name, "/"),
            "reply": node.get_service_names_and_types_by_node(name, "/"),
            "request": node.get_client_names_and_types_by_node(name, "/"),
        }
    finally:
        node.destroy_node()
        rclpy.shutdown()
    common, own = allowed(name)
    for kind, entries in does.items():
        names = {entry for entry, _ in entries}
        assert names <= common[kind] | own[kind], kind
        # the recorder subscribes to what it finds
        if (name, kind) != ("trajectory_recorder", "subscribe"):
            assert own[kind] <= names, kind


def test_the_recorder_may_hear_what_it_is_told_to_record():
    (recorder,) = (
        n for n in launched_nodes("vehicle.launch.py") if n["executable"] == "trajectory_recorder"
    )
    heard = allowed("trajectory_recorder")[1]["subscribe"]
    for pattern in recorder["parameters"]["topics"]:
        name = pattern.removesuffix("*").lstrip("/")
        assert any(topic.startswith(f"/{name}") for topic in heard), pattern


def test_every_launched_node_has_its_enclave():
    for node in launched_nodes("vehicle.launch.py", installed=["robot_state_publisher"]):
        assert node["ros_arguments"] == ["--enclave", f"/tricycle/{node['executable']}"]
        assert allowed(node["executable"])


def test_the_operator_may_call_only_services_that_exist():
    offered = set().union(*(rules["reply"] for name in OF_VEHICLE for rules in allowed(name)))
    requested = allowed("operator")[1]["request"]
    assert requested <= offered
    # a service is called after a greeting: see ServiceCaller
    assert requested >= {f"{service.rpartition('/')[0]}/get_parameters" for service in requested}


def test_the_operator_may_do_what_the_operator_and_the_monitor_do(ros_environment):
    domain = int(ros_environment["ROS_DOMAIN_ID"])
    with Operator(domain=domain, check=lambda: None, simulated=False) as operator:
        does = {
            "publish": operator._node.get_publisher_names_and_types_by_node("operator", "/"),
            "subscribe": operator._node.get_subscriber_names_and_types_by_node("operator", "/"),
        }
    common, own = allowed("operator")
    for kind, entries in does.items():
        assert {entry for entry, _ in entries} <= common[kind] | own[kind], kind
    with Monitor(domain=domain) as monitor:
        node = monitor._node
        heard = {n for n, _ in node.get_subscriber_names_and_types_by_node(node.get_name(), "/")}
        assert fnmatchcase(node.get_name(), "monitor_*")
    common, own = allowed("operator", "monitor_*")
    assert own["subscribe"] <= heard <= own["subscribe"] | common["subscribe"]


def test_the_launch_may_lead_the_bridge_through_its_states():
    own = rules(_profile("/", "launch_ros_*"), "launch_ros_*")
    bridge = allowed("tricycle_bridge")[1]
    assert own["request"] == {"/tricycle_bridge/change_state"} <= bridge["reply"]
    assert own["subscribe"] == {"/tricycle_bridge/transition_event"} <= bridge["publish"]
