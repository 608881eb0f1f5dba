"""What every README of an exported table says of it."""

from l3cli.artifacts.table import TransformTable
from l3cli.columns import printable


def table_facts(table: TransformTable) -> dict[str, object]:
    """Words by the names that the READMEs' texts have for them."""
    return {
        "camera": printable(table.camera_name),
        "bits": table.bits,
        "black": f"{table.black_level:g}",
        "white": f"{table.white_level:g}",
        "outputs": ", ".join(map(printable, table.outputs)),
        "unit": f"{table.output_unit:g}",
        "layers": len(table.layers),
    }
