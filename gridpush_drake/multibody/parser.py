"""A Drake parser that knows this package's models as `package://gridpush_drake/...`."""

from importlib.resources import files
from pathlib import Path

from pydrake.multibody.parsing import PackageMap, Parser
from pydrake.multibody.plant import MultibodyPlant

PACKAGE = "gridpush_drake"


def find_models() -> Path:
    """The folder of the package's models."""
    return Path(str(files("gridpush_drake"))) / "models"


def AddModelsPackage(package_map: PackageMap) -> None:
    """Makes `package://gridpush_drake/...` known to a package map, once."""
    if not package_map.Contains(PACKAGE):
        package_map.AddPackageXml(str(find_models() / "package.xml"))


def MakeParser(plant: MultibodyPlant) -> Parser:
    """Makes a parser for `plant` that finds this package's models; it downloads nothing by itself."""
    parser = Parser(plant)
    AddModelsPackage(parser.package_map())
    return parser
