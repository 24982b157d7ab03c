"""USD as text with one skeleton, and the arrays that our process makes of it."""

_HEAD = """#usda 1.0
(
    metersPerUnit = {metres}
    timeCodesPerSecond = {codes}
    upAxis = "{up}"
)

def SkelRoot "Root"
{{
    matrix4d xformOp:transform = ( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), ({moved}, 0, 0, 1) )
    uniform token[] xformOpOrder = ["xformOp:transform"]

    def Skeleton "Skel" (
        prepend apiSchemas = ["SkelBindingAPI"]
    )
    {{
        uniform token[] joints = ["Hips", "Hips/Spine", "Hips/LeftUpLeg", "Hips/LeftUpLeg/LeftLeg"]
        uniform matrix4d[] bindTransforms = [{bind}]
        uniform matrix4d[] restTransforms = [{rest}]
        {binding}
    }}
{animation}
}}
"""
_ANIMATION = """
    def SkelAnimation "Anim"
    {{
        uniform token[] joints = ["Hips/LeftUpLeg", "Hips"]
        float3[] translations.timeSamples = {{ {translations} }}
        quatf[] rotations.timeSamples = {{ {rotations} }}
        half3[] scales = [(1, 1, 1), (1, 1, 1)]
    }}
"""
PLACES = {"Hips": (0, 1, 0), "Spine": (0, 0.3, 0), "LeftUpLeg": (0.1, 0, 0), "LeftLeg": (0, -0.4, 0)}
WORLD = {"Hips": (0, 1, 0), "Spine": (0, 1.3, 0), "LeftUpLeg": (0.1, 1, 0), "LeftLeg": (0.1, 0.6, 0)}


def _matrix(place):
    return "( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), ({}, {}, {}, 1) )".format(*place)


def make_usda(n_frames=3, *, metres=1.0, codes=24, up="Y", moved=0.0, animated=True, step=1):
    """Hips that rise by 0.1 a frame and a thigh that is turned by half a turn about z from the second frame on."""
    times = [step * frame for frame in range(n_frames)]
    animation = _ANIMATION.format(
        translations=", ".join(f"{time}: [(0.1, 0, 0), (0, {1 + 0.1 * n:g}, 0)]" for n, time in enumerate(times)),
        rotations=", ".join(
            f"{t}: [({'0, 0, 0, 1' if n else '1, 0, 0, 0'}), (1, 0, 0, 0)]" for n, t in enumerate(times)
        ),
    )
    return _HEAD.format(
        metres=metres, codes=codes, up=up, moved=moved,
        bind=", ".join(map(_matrix, WORLD.values())), rest=", ".join(map(_matrix, PLACES.values())),
        binding="rel skel:animationSource = </Root/Anim>" if animated else "", animation=animation if animated else "",
    ).encode()  # fmt: skip


def pack(folder, suffix):
    """The stage of `make_usda` as text, binary or package; needs usd-core."""
    from pxr import Usd, UsdUtils

    (folder / "stage.usda").write_bytes(make_usda())
    target = str(folder / f"packed{suffix}")
    if suffix == ".usda":
        return make_usda()
    if suffix == ".usdz":
        UsdUtils.CreateNewUsdzPackage(str(folder / "stage.usda"), target)
    else:
        Usd.Stage.Open(str(folder / "stage.usda")).Export(target)
    with open(target, "rb") as file:
        return file.read()
