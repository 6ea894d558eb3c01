"""The example's vehicle as a node, with a fault of `planted_faults`: python planted_node.py 'IMU yaw sign'."""

import sys
from pathlib import Path
from typing import Any

# Processes of a graph look for nothing beside a script.
sys.path.insert(0, str(Path(__file__).parent))
from planted_faults import FAULTS
from planted_vehicle import SETTINGS, Fault, PlantedPlant

from examples.vehicle_interface.toy_vehicle import ToyVehicle
from raw2drive_ros.nodes.runtime import run_node
from raw2drive_ros.tables.rates import PHYSICS_HZ


class Changing:
    """A publisher whose messages have the fault."""

    def __init__(self, publisher: Any, topic: str, fault: Fault) -> None:
        self.publisher, self.topic, self.fault = publisher, topic, fault

    def publish(self, message: Any) -> None:
        if self.fault.message is not None:
            self.fault.message(self.topic, message)
        self.publisher.publish(message)


class PlantedNode(ToyVehicle):
    """Faults of plant, cameras and messages; those of rates, ages and QoS are tested without a graph."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(SETTINGS)
        self.plant = PlantedPlant(SETTINGS['vehicle'], fault, self.cameras, PHYSICS_HZ)
        self.outputs = {topic: Changing(output, topic, fault) for topic, output in self.outputs.items()}


if __name__ == '__main__':
    chosen = next(fault for fault in FAULTS if fault.name == sys.argv[1])
    raise SystemExit(run_node(lambda: PlantedNode(chosen)))
