"""URDF of arms of a few links, each by what is unusual in it."""

BODY = """<inertial><origin xyz="{com}"/><mass value="{mass}"/><inertia ixx="{inertia}"
iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial>"""
LINK = """<link name="link{k}">{body}{shape}</link>
<joint name="joint{k}" type="{kind}"><parent link="link{parent}"/><child link="link{k}"/>
<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>
<limit {range} velocity="{velocity}" effort="{effort}"/>{more}</joint>"""
USUAL = {"kind": "revolute", "low": -2, "high": 2, "velocity": 2, "effort": 300}
USUAL |= {"axis": "0 0 1", "xyz": "0 0 0.3", "rpy": "0 0 0"}
USUAL |= {"com": "0.05 0.02 0.1", "shape": "", "more": ""}


def urdf_of(*joints: dict[str, object], **usual: object) -> str:
    """Links 1, 2, ... with their joints, each on the link before it unless it names another."""
    parts = []
    for k, joint in enumerate(joints, start=1):
        own = USUAL | {"k": k, "parent": k - 1} | usual | joint
        own["body"] = BODY.format(**own) if own["mass"] else ""
        bounds = 'lower="{low}" upper="{high}"'.format(**own)
        own["range"] = "" if own["kind"] == "continuous" else bounds
        parts.append(LINK.format(**own))
    return "\n".join(['<robot name="arm"><link name="link0"/>', *parts, "</robot>"])
