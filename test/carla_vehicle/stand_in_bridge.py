"""The CARLA bridge node with the stand-in for the server; prints the controls that the car received as JSON."""

import json
import sys
from pathlib import Path
from types import SimpleNamespace

import carla

# Processes of a graph look for nothing beside a script.
sys.path.insert(0, str(Path(__file__).parent))
import stand_in

from raw2drive_ros.carla_vehicle import client
from raw2drive_ros.nodes import carla_bridge

if __name__ == '__main__':
    types = ('Location', 'Rotation', 'Transform', 'VehicleControl')
    package = SimpleNamespace(Client=stand_in.Client, **{name: getattr(carla, name) for name in types})
    client.import_carla = lambda: package
    stand_in.Client.world = stand_in.World()
    # A gate does not take over a car that moves already.
    stand_in.Client.world.speed = 0.0
    code = carla_bridge.main(sys.argv)
    car = stand_in.Client.world.actors[0]
    print(json.dumps([(control.throttle, control.brake, control.steer) for control in car.controls]))
    raise SystemExit(code)
