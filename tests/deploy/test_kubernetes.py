"""What the cluster's own programs cannot check: that the resources fit our code and settings."""

import importlib.util
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml

from clustermcl.runtime.settings_file import load_settings
from tests.unit.evaluation.places import STATUS

FOLDER = Path(__file__).parents[2] / "deploy" / "kubernetes"
KUSTOMIZATION = yaml.safe_load((FOLDER / "kustomization.yaml").read_text())
RESOURCES = [
    resource
    for name in KUSTOMIZATION["resources"]
    for resource in yaml.safe_load_all((FOLDER / name).read_text())
]
POOL, SCALER = yaml.safe_load_all((FOLDER / "pool" / "pool.yaml").read_text())
SETTINGS = load_settings(FOLDER / "settings.toml", [])

Object = dict[str, Any]


def of_kind(*kinds: str) -> list[Object]:
    return [resource for resource in RESOURCES if resource["kind"] in kinds]


WORKLOADS = [*of_kind("Deployment", "StatefulSet"), POOL]
PODS = {made["metadata"]["name"]: made["spec"]["template"]["spec"] for made in WORKLOADS}


def mounts(name: str) -> dict[str, Path]:
    (container,) = PODS[name]["containers"]
    return {mount["name"]: Path(mount["mountPath"]) for mount in container["volumeMounts"]}


def test_selectors_match_the_labels_of_their_pods() -> None:
    labels = [made["spec"]["template"]["metadata"]["labels"] for made in WORKLOADS]
    assert [made["spec"]["selector"]["matchLabels"] for made in WORKLOADS] == labels
    chosen = [made["spec"]["selector"] for made in of_kind("Service")]
    policies = [made["spec"]["podSelector"] for made in of_kind("NetworkPolicy")]
    policies += [made["spec"]["selector"] for made in of_kind("PodDisruptionBudget")]
    for selector in (*chosen, *(policy["matchLabels"] for policy in policies if policy)):
        assert sum(selector.items() <= of.items() for of in labels[:-1]) == 1


def test_ports_lead_to_ports_of_the_pods_and_are_those_of_the_settings() -> None:
    named = {
        port["name"]: port["containerPort"]
        for pod in PODS.values()
        for port in pod["containers"][0].get("ports", [])
    }
    for service in of_kind("Service"):
        assert {port["targetPort"] for port in service["spec"].get("ports", [])} <= set(named)
    for policy in of_kind("NetworkPolicy"):
        for way in policy["spec"].get("ingress", []):
            assert {port["port"] for port in way["ports"]} <= set(named)
    assert SETTINGS.metrics.port == named["metrics"]
    assert SETTINGS.zenoh.router == f"tls/router:{named['zenoh']}"


@pytest.mark.parametrize("name", PODS)
def test_every_pod_runs_a_process_of_ours_with_mounted_files(name: str) -> None:
    pod = PODS[name]
    (container,) = pod["containers"]
    if name != "router":  # the official one
        assert container["image"] in {image["name"] for image in KUSTOMIZATION["images"]}
        assert importlib.util.find_spec(f"{container['args'][0]}.__main__") is not None
    assert set(mounts(name)) == {volume["name"] for volume in pod["volumes"]}


def test_the_settings_and_the_router_name_mounted_files() -> None:
    at = mounts("bridge")
    assert Path(SETTINGS.bridge.map).parent == at["map"]
    for file in (SETTINGS.zenoh.tls_certificate, SETTINGS.zenoh.tls_private_key):
        assert Path(file).parent == at["certificate"]
    (container,) = PODS["coordinator"]["containers"]
    probe = container["readinessProbe"]["exec"]["command"]
    assert Path(probe[probe.index("--settings") + 1]) in mounts("coordinator").values()
    text = (FOLDER / "router-secure.json5").read_text()
    assert text == (FOLDER.parent / "router-secure.json5").read_text()
    tls = json.loads(re.sub(r"^//.*\n", "", text, flags=re.MULTILINE))["transport"]["link"]["tls"]
    files = {Path(tls[name]).parent for name in tls if name.endswith(("_key", "_certificate"))}
    assert files <= set(mounts("router").values())
    (pool,) = POOL["spec"]["template"]["spec"]["containers"]
    fleet = str(mounts(POOL["metadata"]["name"])["fleet"])
    assert pool["args"][:3] == ["clustermcl.worker", "--fleet", fleet]


def test_the_pool_scales_by_a_metric_that_coordinators_serve() -> None:
    external = SCALER["spec"]["metrics"][0]["external"]["metric"]["name"]
    metrics = pytest.importorskip("clustermcl.link.metrics_of_status", reason="the extra metrics")
    collector = metrics.StatusCollector(lambda: STATUS, "r1")
    assert external in {metric.name for metric in collector.collect()}


def test_kubernetes_schema_has_no_objection() -> None:
    validate = pytest.importorskip("kubernetes_validate", reason="kubernetes-validate is not there")
    for resource in [*RESOURCES, POOL, SCALER]:
        validate.validate(resource, "1.31", strict=True)


def test_kustomize_builds_all_resources() -> None:
    if (kubectl := shutil.which("kubectl")) is None:
        pytest.skip("kubectl is not installed")
    ran = subprocess.run([kubectl, "kustomize", FOLDER], capture_output=True, check=False)
    assert ran.returncode == 0, ran.stderr
    made = list(yaml.safe_load_all(ran.stdout))
    assert len(made) == len(RESOURCES) + len(KUSTOMIZATION["configMapGenerator"])
    assert "clustermcl" not in re.findall(r"image: (\S+)", ran.stdout.decode())
