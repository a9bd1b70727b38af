"""A package of meshes, one of each kind: a coloured square of a metre each, seen from above."""

from __future__ import annotations

import json
import struct
import zlib
from pathlib import Path

PACKAGE = "eyes_description"
PLACES = {
    "red.stl": (-4.0, 3.0),
    "green.dae": (-4.0, 0.0),
    "blue.obj": (-4.0, -3.0),
    "green.glb": (4.0, -3.0),
}
"""Where each stands in the frame of the robot's base."""
HUES = {mesh: mesh.partition(".")[0] for mesh in PLACES}
_CORNERS = ((-0.5, -0.5, 0.0), (0.5, -0.5, 0.0), (0.5, 0.5, 0.0), (-0.5, 0.5, 0.0))
_FACES = ((0, 1, 2), (0, 2, 3))
_DAE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="meter" meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_images><image id="i"><init_from>../textures/green%20one.png</init_from></image></library_images>
<library_effects><effect id="e"><profile_COMMON>
<newparam sid="f"><surface type="2D"><init_from>i</init_from></surface></newparam>
<newparam sid="s"><sampler2D><source>f</source></sampler2D></newparam>
<technique sid="t"><lambert><diffuse><texture texture="s" texcoord="UV"/></diffuse></lambert></technique>
</profile_COMMON></effect></library_effects>
<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="12">{corners}</float_array><technique_common><accessor source="#pa" count="4" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<source id="n"><float_array id="na" count="3">0 0 1</float_array><technique_common><accessor source="#na" count="1" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<source id="u"><float_array id="ua" count="2">0.5 0.5</float_array><technique_common><accessor source="#ua" count="1" stride="2">
<param name="S" type="float"/><param name="T" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="2" material="m"><input semantic="VERTEX" source="#v" offset="0"/><input semantic="NORMAL" source="#n" offset="1"/>
<input semantic="TEXCOORD" source="#u" offset="2" set="0"/><p>0 0 0 1 0 0 2 0 0 0 0 0 2 0 0 3 0 0</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="vs"><node><instance_geometry url="#g"><bind_material><technique_common>
<instance_material symbol="m" target="#m"><bind_vertex_input semantic="UV" input_semantic="TEXCOORD" input_set="0"/></instance_material>
</technique_common></bind_material></instance_geometry></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#vs"/></scene></COLLADA>"""


def visuals() -> str:
    """Return the visuals of a link that shows them all, one of which is not there, and one twice."""
    made = [_visual(mesh, x, y, mesh.startswith("red")) for mesh, (x, y) in PLACES.items()]
    return "".join([*made, _visual("none.stl", 4.0, 3.0), _visual("red.stl", -5.5, 3.0, red=True)])


def _visual(mesh: str, x: float, y: float, red: bool = False) -> str:  # noqa: FBT001, FBT002
    colour = '<material name=""><color rgba="0.9 0.1 0.1 1"/></material>' if red else ""
    return (
        f'<visual><origin xyz="{x} {y} 0.1"/><geometry>'
        f'<mesh filename="package://{PACKAGE}/meshes/{mesh}"/></geometry>{colour}</visual>'
    )


def write(folder: Path) -> None:
    """Write the package's folder."""
    meshes, textures = folder / "meshes", folder / "textures"
    meshes.mkdir()
    textures.mkdir()
    (textures / "green one.png").write_bytes(_png(16, 200, 16))
    (meshes / "red.stl").write_bytes(_stl())
    flat = " ".join(f"{value}" for corner in _CORNERS for value in corner)
    (meshes / "green.dae").write_text(_DAE.format(corners=flat))
    lines = [f"v {x} {y} {z}" for x, y, z in _CORNERS]
    (meshes / "blue.obj").write_text(
        "\n".join(["mtllib blue.mtl", *lines, "vn 0 0 1", "usemtl blue", "f 1//1 2//1 3//1 4//1"])
    )
    (meshes / "blue.mtl").write_text("newmtl blue\nKd 0.1 0.1 0.9\n")
    (meshes / "green.glb").write_bytes(_glb())


def _stl() -> bytes:
    faces = b"".join(
        struct.pack("<12fH", 0, 0, 1, *(v for at in face for v in _CORNERS[at]), 0)
        for face in _FACES
    )
    return bytes(80) + struct.pack("<I", len(_FACES)) + faces


def _glb() -> bytes:
    data = b"".join(struct.pack("<3f", *_CORNERS[at]) for face in _FACES for at in face)
    described = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
        "materials": [
            {"pbrMetallicRoughness": {"baseColorFactor": [0, 0.6, 0, 1], "metallicFactor": 0}}
        ],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": 6,
                "type": "VEC3",
                "min": [-0.5, -0.5, 0],
                "max": [0.5, 0.5, 0],
            }
        ],
        "bufferViews": [{"buffer": 0, "byteLength": len(data)}],
        "buffers": [{"byteLength": len(data)}],
    }
    text = json.dumps(described).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text
    body += struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def _png(*colour: int) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    head = struct.pack(">IIBBBBB", 4, 4, 8, 2, 0, 0, 0)
    rows = zlib.compress((b"\0" + bytes(colour) * 4) * 4)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")
