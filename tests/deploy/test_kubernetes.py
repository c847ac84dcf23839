import importlib.util
import json
import re
import shutil
import subprocess
from collections.abc import Iterator
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

Object = dict[str, Any]


def of_kind(*kinds: str) -> list[Object]:
    return [resource for resource in RESOURCES if resource["kind"] in kinds]


def workloads() -> list[Object]:
    return of_kind("Deployment", "StatefulSet")


def pods() -> dict[str, Object]:
    return {made["metadata"]["name"]: made["spec"]["template"]["spec"] for made in workloads()}


def containers() -> Iterator[tuple[str, Object]]:
    for name, pod in pods().items():
        for container in pod["containers"]:
            yield name, container


def pod_labels() -> list[Object]:
    return [made["spec"]["template"]["metadata"]["labels"] for made in workloads()]


def selects(selector: Object, labels: Object) -> bool:
    return selector.items() <= labels.items()


def test_selectors_match_the_labels_of_their_pods() -> None:
    for made in workloads():
        labels = made["spec"]["template"]["metadata"]["labels"]
        assert made["spec"]["selector"]["matchLabels"] == labels
        for spread in made["spec"]["template"]["spec"].get("topologySpreadConstraints", []):
            assert spread["labelSelector"]["matchLabels"] == labels
    chosen = [made["spec"]["selector"] for made in of_kind("Service")]
    chosen += [made["spec"]["selector"]["matchLabels"] for made in of_kind("PodDisruptionBudget")]
    policies = [made["spec"]["podSelector"] for made in of_kind("NetworkPolicy")]
    chosen += [policy["matchLabels"] for policy in policies if policy]
    for selector in chosen:
        assert sum(selects(selector, labels) for labels in pod_labels()) == 1


def test_ports_lead_to_ports_of_the_pods() -> None:
    named = {
        port["name"]: port["containerPort"]
        for _, container in containers()
        for port in container.get("ports", [])
    }
    for service in of_kind("Service"):
        for port in service["spec"].get("ports", []):
            assert port["targetPort"] in named
    for policy in of_kind("NetworkPolicy"):
        for way in policy["spec"].get("ingress", []):
            assert {port["port"] for port in way["ports"]} <= set(named)
    settings = load_settings(FOLDER / "settings.toml", [])
    assert settings.metrics.port == named["metrics"]
    assert settings.zenoh.router == f"tls/router:{named['zenoh']}"


def test_every_pod_runs_a_process_of_ours_or_the_official_router() -> None:
    for name, container in containers():
        if name == "router":
            assert container["image"].startswith("docker.io/eclipse/zenoh:")
            continue
        assert container["image"] in {image["name"] for image in KUSTOMIZATION["images"]}
        assert importlib.util.find_spec(f"{container['args'][0]}.__main__") is not None


def test_every_mounted_volume_is_declared_and_every_declared_volume_is_mounted() -> None:
    generated = {made["name"] for made in KUSTOMIZATION["configMapGenerator"]}
    for name, pod in pods().items():
        volumes = {volume["name"]: volume for volume in pod["volumes"]}
        mounts = {m["name"]: m["mountPath"] for c in pod["containers"] for m in c["volumeMounts"]}
        assert set(mounts) == set(volumes), name
        assert volumes["certificate"]["secret"]["secretName"] == f"certificate-{name}"
        for volume in volumes.values():
            assert volume.get("configMap", {"name": "map"})["name"] in generated | {"map"}
    settings = load_settings(FOLDER / "settings.toml", [])
    mounts = {m["name"]: m["mountPath"] for m in pods()["bridge"]["containers"][0]["volumeMounts"]}
    assert Path(settings.bridge.map).parent == Path(mounts["map"])
    for file in (settings.zenoh.tls_certificate, settings.zenoh.tls_private_key):
        assert Path(file).parent == Path(mounts["certificate"])


def test_no_pod_has_more_rights_than_it_needs() -> None:
    for name, pod in pods().items():
        assert pod["automountServiceAccountToken"] is False, name
        assert pod["securityContext"]["runAsNonRoot"] is True, name
        assert pod["securityContext"]["runAsUser"] == 10001, name
        assert pod["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}, name
        for volume in pod["volumes"]:
            assert volume.get("secret", {"defaultMode": 0o440})["defaultMode"] == 0o440
    for name, container in containers():
        context = container["securityContext"]
        assert context["allowPrivilegeEscalation"] is False, name
        assert context["readOnlyRootFilesystem"] is True, name
        assert context["capabilities"] == {"drop": ["ALL"]}, name


def test_the_readiness_probe_reads_mounted_settings() -> None:
    (container,) = pods()["coordinator"]["containers"]
    command = container["readinessProbe"]["exec"]["command"]
    assert command[:2] == ["clustermcl", "status"]
    mounts = {mount["mountPath"] for mount in container["volumeMounts"]}
    assert command[command.index("--settings") + 1] in mounts


def test_the_routers_file_is_the_deployed_one_and_finds_its_certificates() -> None:
    text = (FOLDER / "router-secure.json5").read_text()
    assert text == (FOLDER.parent / "router-secure.json5").read_text()
    tls = json.loads(re.sub(r"^//.*\n", "", text, flags=re.MULTILINE))["transport"]["link"]["tls"]
    (router,) = pods()["router"]["containers"]
    mounts = {mount["mountPath"] for mount in router["volumeMounts"]}
    assert {
        str(Path(tls[name]).parent) for name in tls if name.endswith(("_key", "_certificate"))
    } <= mounts


def test_the_pool_has_the_rights_of_a_worker_and_reads_the_mounted_fleet() -> None:
    pod, worker = POOL["spec"]["template"]["spec"], pods()["worker"]
    for name in ("securityContext", "automountServiceAccountToken", "enableServiceLinks"):
        assert pod[name] == worker[name]
    (container,) = pod["containers"]
    assert container["securityContext"] == worker["containers"][0]["securityContext"]
    mounts = {mount["name"]: mount["mountPath"] for mount in container["volumeMounts"]}
    assert set(mounts) == {volume["name"] for volume in pod["volumes"]}
    assert container["args"][:3] == ["clustermcl.worker", "--fleet", mounts["fleet"]]
    assert POOL["spec"]["selector"]["matchLabels"] == POOL["spec"]["template"]["metadata"]["labels"]


def test_the_pool_scales_by_a_metric_that_coordinators_serve() -> None:
    target = SCALER["spec"]["scaleTargetRef"]
    assert (target["kind"], target["name"]) == (POOL["kind"], POOL["metadata"]["name"])
    external = SCALER["spec"]["metrics"][0]["external"]["metric"]["name"]
    metrics = pytest.importorskip("clustermcl.link.metrics_of_status", reason="the extra metrics")
    collector = metrics.StatusCollector(lambda: STATUS, "r1")
    assert external in {metric.name for metric in collector.collect()}


def test_kubernetes_schema_has_no_objection() -> None:
    validate = pytest.importorskip("kubernetes_validate", reason="kubernetes-validate is not there")
    for resource in [*RESOURCES, POOL, SCALER]:
        validate.validate(resource, "1.31", strict=True)


def test_kustomize_builds_all_resources() -> None:
    kubectl = shutil.which("kubectl")
    if kubectl is None:
        pytest.skip("kubectl is not installed")
    ran = subprocess.run([kubectl, "kustomize", str(FOLDER)], capture_output=True, check=False)
    assert ran.returncode == 0, ran.stderr
    made = list(yaml.safe_load_all(ran.stdout))
    assert len(made) == len(RESOURCES) + len(KUSTOMIZATION["configMapGenerator"])
    images = re.findall(r"image: (\S+)", ran.stdout.decode())
    assert "clustermcl" not in images
