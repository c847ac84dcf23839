"""Makes a folder of ROS 2 as its wheels fill it into a folder like /opt/ros/jazzy.

Adds the message packages that have no wheel, by ROS's own generators, and `setup.bash`. Run by a
Python with the packages of locks/requirements-ros-tools.lock: `make_tree.py FOLDER`.
"""

import json
import os
import subprocess
import sys
import sysconfig
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from pathlib import Path

import numpy as np

DEFINITIONS = Path(__file__).parent / "definitions"
PACKAGES = ("tf2_msgs", "bond", "nav2_msgs", "vision_msgs", "apriltag_msgs")
_FAST, _INTROSPECTION = "rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c"
_LIBRARIES = ("rosidl_generator_c", "rosidl_typesupport_c", _FAST, _INTROSPECTION)
"""Each package has these; here one file is all of them, and the module of Python too."""


def main(tree: Path) -> None:
    [modules] = tree.glob("lib/python*/site-packages")
    sys.path.insert(0, str(modules))
    for library in modules.glob("ros_*.libs/*"):  # of the wheels; apt has them in /usr/lib
        if not (link := tree / "lib" / library.name).exists():
            link.symlink_to(library)
    for package in PACKAGES:
        generate(package, tree, modules)
    write_setup(tree)


def generate(package: str, tree: Path, modules: Path) -> None:
    """Generate and compile one package; its types may be made of those of earlier ones."""
    share = tree / "share" / package
    headers, python = tree / "include" / package / package, modules / package
    introspection = (
        tree / "include" / f"{package}_introspection" / package
    )  # of the same file names
    adapter = import_module("rosidl_adapter.msg"), import_module("rosidl_adapter.srv")
    tuples, files = [], sorted((DEFINITIONS / package).rglob("*.[ms][sr][gv]"))
    for file in files:
        relative = file.relative_to(DEFINITIONS / package)
        (share / relative.parent).mkdir(parents=True, exist_ok=True)
        kind = file.suffix[1:]
        convert = getattr(adapter[kind == "srv"], f"convert_{kind}_to_idl")
        convert(DEFINITIONS / package, package, relative, share / relative.parent)
        tuples.append(f"{share}:{relative.with_suffix('.idl')}")
    others = [path.parent for path in (tree / "share").glob("*/package.xml")]
    common = {
        "package_name": package,
        "idl_tuples": tuples,
        "ros_interface_dependencies": [
            f"{one.name}:{idl}" for one in others for idl in one.rglob("*.idl")
        ],
        "target_dependencies": [],
        "include_paths": [f"{one.name}:{one}" for one in others],
    }

    def run(module: str, function: str, out: Path, *more: object, **also: object) -> None:
        out.mkdir(parents=True, exist_ok=True)
        templates = tree / "share" / module / "resource"
        arguments = common | also | {"output_dir": str(out), "template_dir": str(templates)}
        file = out / "arguments.json"
        file.write_text(json.dumps(arguments))
        getattr(import_module(module), function)(str(file), *more)

    run("rosidl_generator_type_description", "generate_type_hash", share)
    described = [f"{one.rpartition(':')[2]}:{one.replace(':', '/')[:-4]}.json" for one in tuples]
    also = {"type_description_tuples": described}
    run("rosidl_generator_c", "generate_c", headers, **also)
    run(_FAST, "generate_typesupport_fastrtps_c", headers, **also)
    run(_INTROSPECTION, "generate_c", introspection, **also)
    run("rosidl_typesupport_c", "generate_c", headers, [_FAST, _INTROSPECTION], **also)
    run("rosidl_generator_py", "generate_py", python, ["rosidl_typesupport_c"], **also)
    (python / "__init__.py").touch()
    for name in _LIBRARIES:
        (headers / "msg" / f"{name}__visibility_control.h").write_text(
            "#pragma once\n"
            + "".join(
                f"#define {f'{name}_{what}_{package}'.replace(name, name.upper())}\n"
                for what in ("PUBLIC", "IMPORT", "EXPORT")
            )
        )
    folders = (headers, introspection, python)
    compiled(
        package,
        tree,
        modules,
        [one for folder in folders for one in folder.rglob("*.c*") if one.suffix != ".o"],
    )
    add_to_index(package, tree)


def compiled(package: str, tree: Path, modules: Path, sources: list[Path]) -> None:
    """Compile all into one module of Python, on all cores."""
    include = [tree / "include", *(tree / "include").iterdir(), modules, np.get_include()]
    flags = [f"-I{folder}" for folder in [*include, sysconfig.get_path("include")]]

    def compile_one(source: Path) -> str:
        compiler = "g++" if source.suffix == ".cpp" else "gcc"
        object_file = f"{source}.o"
        subprocess.run(
            [compiler, "-fPIC", "-O0", "-w", "-c", source, "-o", object_file, *flags], check=True
        )
        return object_file

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        objects = list(pool.map(compile_one, sources))
    suffix = sysconfig.get_config_var("EXT_SUFFIX")
    module = modules / package / f"{package}_s__rosidl_typesupport_c{suffix}"
    kinds = (
        *_LIBRARIES,
        "rosidl_generator_py",
        "rosidl_runtime_c",
        "rosidl_typesupport_fastrtps_cpp",
    )
    libraries = [one for kind in kinds for one in (tree / "lib").glob(f"lib*{kind}.so")]
    libraries += [tree / "lib" / f"lib{name}.so" for name in ("rcutils", "fastcdr")]
    subprocess.run(
        ["g++", "-shared", "-o", module, *objects, *libraries, "-Wl,--allow-shlib-undefined"],
        check=True,
    )
    for name in _LIBRARIES:
        (tree / "lib" / f"lib{package}__{name}.so").symlink_to(module)


def add_to_index(package: str, tree: Path) -> None:
    share = tree / "share" / package
    (share / "package.xml").write_text(
        f"<package format='3'><name>{package}</name><version>0.0.0</version></package>\n"
    )
    (tree / "share" / "ament_index" / "resource_index" / "packages" / package).touch()


def write_setup(tree: Path) -> None:
    templates = import_module("ament_package.templates")
    values = {"CMAKE_INSTALL_PREFIX": str(tree), "ament_package_PYTHON_EXECUTABLE": sys.executable}
    for name in templates.get_prefix_level_template_names():
        file = templates.get_prefix_level_template_path(name)
        text = (
            templates.configure_file(file, values)
            if name.endswith(".in")
            else Path(file).read_text()
        )
        (tree / name.removesuffix(".in")).write_text(text)


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())
