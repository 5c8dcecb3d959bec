"""From objects and YAML to a MultibodyPlant: parser, schemas, grid objects, SDFormat."""
