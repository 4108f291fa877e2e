"""Refused input and the messages about it.

A row is a command line, how the message begins, and what else is in it. The files that commands
name lie in the current folder, which messages are shown without; HERE stands for it where a command
takes paths from elsewhere.
"""

from __future__ import annotations

import yaml

from deploy.scenario.scenario import SHIPPED

BASE = (SHIPPED / "paper_arm.yaml").read_text()
LONG = "x" * 5000
TENFOLD = "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 9))
GRID = "{from: 0, to: 9999, step: 1}"
UNCERTAIN = "{plant.paylod_kg: {distribution: uniform, from: 0, to: 1}}"
KEYS = {"name": "mine", **yaml.safe_load(BASE)}
del KEYS["duration_s"]
FILES = {
    "broken.yaml": "name: [",
    "list.yaml": "- name\n- duration_s\n",
    "text.yaml": "just words",
    "empty.yaml": "",
    "binary.yaml": b"\xff\xfe\x00",
    "missing.yaml": yaml.safe_dump(KEYS),
    "bomb.yaml": f"a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n{TENFOLD}{BASE}",
    "nowhere.yaml": "extends: nowhere\nname: mine\n",
    "long.yaml": f"extends: {LONG}\nname: mine\n",
    "twice.yaml": "extends: paper_arm\nduration_s: 1\nseed: 2\nduration_s: 3\n",
    "inner.yaml": "extends: paper_arm\nplant: {payload_kg: 1, friction: {}, payload_kg: 1}\n",
    "circle.yaml": "extends: circle_2.yaml\n",
    "circle_2.yaml": "extends: circle.yaml\n",
    "self.yaml": "extends: self.yaml\n",
    "grandchild.yaml": "extends: nowhere.yaml\n",
    "sweep.yaml": "name: a\nscenario: paper_arm\ngrid: {plant.payload_kg: [0, -1]}\n",
    "big.yaml": f"name: big\nscenario: paper_arm\ngrid: {{seed_1: {GRID}, b: {GRID}}}\n",
    "set.yaml": "name: a\nscenario: paper_arm\nset: {plant.paylod_kg: 1}\ngrid: {}\n",
    "typo.yaml": "name: a\nscenari: paper_arm\ngrid: {}\n",
    "no_delays.txt": "",
    "negative.txt": "1\n-2\n",
    "half.urdf": "<robot",
    "model.urdf": "<model/>",
    "jointless.urdf": '<robot name="r"><link name="a"/><link name="b"/>'
    '<joint name="j" type="fixed"><parent link="a"/><child link="b"/></joint></robot>',
    "damaged/run.mcap": b"no recording",
    "nothing/notes.txt": "",
    "arms/a.urdf": "<robot",
    "arms/law.py": "",
    "smc/law.py": "",
    "file": "",
}
REFUSED = [
    # scenarios and files
    ("run paper_leg", "paper_leg: ", "paper_arm"),
    ("simulate nowhere", "nowhere: ", "paper_arm_mit, ur10e_motors, ur5e_motors, faults/*"),
    ("simulate faults/nothing_like_it", "faults/nothing_like_it: ",
     "faults/actuator_dead, faults/actuator_weak"),
    ("simulate /dev/null", "/dev/null: is not a regular file, nor one of the shipped"),
    ("simulate .", ".: is a folder: must be a file, such as ", "broken.yaml"),
    ("policy funnel_hil:Demonstrator arms", "policy: arms: is a folder: must be a file, such as",
     "a.urdf in it"),
    ("robot arms", "arms: is a folder: must be a file, such as a.urdf in it"),
    ("simulate paper_arm --set robot.urdf=arms", "", "is a folder: must be a file, such as a.urdf"),
    ("policy smc paper_arm --merges none", "policy: controller.chunks.merge = 'none'"),
    ("simulate arms/aa.urdf", "arms/aa.urdf: no such file", "did you mean arms/a.urdf?"),
    ("policy arms", "POLICY arms: is a folder (modules in it: law): must be MODULE:CLASS"),
    ("robot nothing", "nothing: is a folder without a file .urdf, .xacro, .xml"),
    (f"simulate {LONG}", "", "no such file"),
    (f"sweep {LONG}", "", "no such file"),
    (f"margin --study {LONG}", "", "no such file"),
    ("run broken.yaml", "broken.yaml: ", "YAML"),
    ("run list.yaml", "list.yaml: ", "a mapping of keys to values"),
    ("run text.yaml", "text.yaml: ", "a mapping of keys to values"),
    ("run empty.yaml", "empty.yaml: ", "a mapping of keys to values"),
    ("run binary.yaml", "binary.yaml: ", "YAML"),
    ("run missing.yaml", "missing.yaml: duration_s: is missing"),
    ("run bomb.yaml", "bomb.yaml: a4 = ", "must have at most 100000 values"),
    ("run nowhere.yaml", "nowhere.yaml: extends = ", "no such file"),
    ("run long.yaml", "long.yaml: extends = ", "no such file"),
    ("run circle.yaml", "circle_2.yaml: extends = 'circle.yaml': must be no circle: ",
     "circle.yaml extends circle_2.yaml extends circle.yaml"),
    ("run self.yaml", "self.yaml: ", "must be no circle: self.yaml extends self.yaml"),
    ("run grandchild.yaml", "nowhere.yaml: extends = nowhere: no such file"),
    ("run twice.yaml", "twice.yaml: duration_s = ", "must occur only once; ", "lines 2 and 4"),
    ("run inner.yaml", "inner.yaml: plant.payload_kg = ", "must occur only once; "),
    ("sweep big.yaml", "big.yaml: ", "are 100000000 runs; at most 100000 are allowed"),
    ("sweep sweep.yaml", "sweep.yaml: grid plant.payload_kg=-1: "),
    ("sweep set.yaml", "set.yaml: set plant.paylod_kg=1: ", "mean payload_kg"),
    ("sweep typo.yaml", "typo.yaml: scenari", "did you mean scenario"),
    ("replay nothing", "nothing: "),
    ("report nothing", "nothing: "),
    ("replay damaged", "damaged", "is not a recording of funnel-hil"),
    ("report damaged", "damaged", "is not a recording of funnel-hil"),
    ("runs list nowhere", "nowhere: no such folder"),
    ("runs tag nowhere a", "nowhere: holds no results"),
    ("view nowhere", "nowhere: has no run.mcap"),
    ("view tcp/nowhere", "tcp/nowhere: has no run.mcap"),
    ("runs prune .", "", "give --older-than, --incomplete, or both"),
    ("robot nowhere.urdf", "", "nowhere.urdf"),
    ("reference paper_arm", "", "one of --csv and --parquet"),
    ("ros2-control paper_arm --out file", "", "cannot be written"),
    ("ros-package file", "", "cannot be written"),
    ("export damaged --latex --out file", "--out file", "is a file: must be a folder"),
    ("export damaged --bibtex --columns 2", "--columns", "without --figures and --latex"),
    ("export damaged --bibtex --series tracking", "--series", "left out without --csv"),
    ("export damaged", "", "must be given one or more of --csv, --parquet"),
    *[(f"{command} paper_arm --set link.security.enabled=true --set link.security.folder=/nowhere",
       "/nowhere/authority.crt: does not exist") for command in ("run", "controller", "record")],
    # over a real delay, and confirmed
    *[(f"run paper_arm --real-delay {given}", "--real-delay ", "must be a round trip of 0 to 1000")
      for given in ("1000.1", "nan")],
    *[(f"run {scenario} --real-delay 5 --set {setting}", "", text)
      for scenario, setting, text in (
          ("paper_arm", "clock=lockstep", "clock = 'lockstep': must be realtime"),
          ("paper_arm_can", "clock=realtime", "link.kind = 'can': must be zenoh"),
          ("paper_arm", "link.plant_endpoint=udp/127.0.0.1:7451", "must be tcp/ or"),
          ("paper_arm", "link.router_endpoint=tcp/127.0.0.1:7447", "must be left out"),
          ("paper_arm", "'link.uplink.pattern={shape: square, period_ms: 4}'",
           "link.uplink.pattern = {'shape': 'square', 'period_ms': 4.0}: must be left out"))],
    ("relay nowhere 127.0.0.1:1 --delay 1", "", "'nowhere': must be HOST:PORT"),
    ("relay 127.0.0.1:1 127.0.0.1:2 --delay -1", "", "--delay -1: must be 0 to 1000 ms"),
    ("run --confirm --set clock=realtime", "", "clock = 'realtime': must be lockstep"),
    ("run --confirm --set clock=lockstep"
     " --set 'faults=[{kind: process_killed, target: plant, at_s: 1}]'", "", "must be without"),
    *[(f"{command} --set controller.process=[./nope]",
       "--set controller.process=[./nope]: controller.process = ")
      for command in ("run", "simulate")],
    # where results go
    ("run --out file", "--out file: cannot be created"),
    ("run --out file/below", "--out file/below: cannot be created"),
    *[(f"{words} --out loop{below}", f"--out loop{below}: cannot be created")
      for words in ("simulate", "compare --laws pid", "margin --laws pid")
      for below in ("", "/below")],
    # options
    ("compare --laws pid,smcc", "--laws 'smcc': must be one of fixed_time_neural"),
    ("margin --laws pid,smcc", "--laws 'smcc': must be one of fixed_time_neural"),
    *[(f"margin {option} {given}", f"{option}: {shown}' is not valid YAML")
      for option in ("--seeds", "--values", "--offsets", "--running")
      for given, shown in (("[", "'["), ("\udcff", r"'\udcff"))],  # the latter is no UTF-8
    ("margin --seeds 0", "", "seeds", "0", "from 1"),
    ("margin --offsets 1,1", "", "offsets", "different"),
    ("margin --offsets x", "", "offsets", "'x'", "number"),
    ("margin --offsets 20", "", "robot.initial_offset_rad"),
    ("margin --duration -1", "", "duration_s", "-1", "greater than 0"),
    ("margin --compensation maybe", "", "compensation", "'maybe'"),
    ("margin --drive-feedback maybe", "", "drive_feedback", "'maybe'"),
    ("margin --set link.nonsense=1", "", "link.nonsense", "unknown key"),
    ("margin --study none", "", "none", "shipped studies", "delay_margin"),
    ("margin --workers 1 --scheduler tcp://127.0.0.1:1", "", "--workers", "--scheduler"),
    ("margin --plants 2 --uncertainty half", "", "values: is missing"),
    ("sweep delay_sweep --scheduler here", "--scheduler here: must be"),
    ("margin --pattern some", "", "pattern", "'some'", "'any'"),
    ("margin --pattern any --quantity loss", "", "pattern = 'any': must be left out for loss"),
    ("margin --what-helps --plants 2 --uncertainty half --values 8", "", "what_helps = True"),
    ("margin --pattern any --plants 2 --uncertainty half --values 8", "", "pattern = 'any'"),
    ("margin --pattern any --set 'link.uplink.pattern={shape: falling, period_ms: 9}'", "",
     "link.uplink.pattern = ", "must be given without pattern"),
    ("margin paper_arm_can --laws pid --pattern any", "", "link.uplink = ", "delay_ms alone"),
    ("margin --quantity temperature", ""),
    ("margin --quantity robot.initial_offset_rad", ""),  # one per joint
    *[(f"drives paper_arm --set link.can.interface=virtual --fault {fault}",
       f"--fault = '{fault}'", words)
      for fault, words in (
          ("drive:9@1s", "one of the nodes 1, 2, 3"), ("drive:2", "kind:node@time"),
          ("drive:2@1", "kind:node@time"), ("drive:2@-1s", "kind:node@time"),
          ("drive:2@1s+", "kind:node@time"),
          ("fire:2@1s", "drive, silent, encoder-frozen, over-temperature"))],
    ("drives paper_arm --set link.can.eds=/etc/hostname", "", "that is an EDS of a CiA 402 drive"),
    ("drives paper_arm --set link.can.protocol=mit --set link.can.fd_process_data=true", "", "MIT"),
    ("drives paper_arm --set link.can.interface=nope", "", "must be an interface of python-can"),
    ("margin --duration 8 --set duration_s=20", "",
     "--duration and --set duration_s: must not be given together"),
    *[(f"margin --compensation off --drive-feedback off --laws pid --set {given}", "",
       given.strip("'").partition("=")[0], option)
      for given, option in (
          ("seed=2", "--seeds"), ("controller.law=pid", "--laws"),
          ("link.downlink.delay_ms=4", "quantity"), ("link.downlink=4", "must be"),
          ("controller.delay_compensation.enabled=true", "--compensation"),
          ("controller.drive_feedback.enabled=true", "--drive-feedback"),
          ("'uncertainty={a: 1}'", "--plants"))],
    *[(f"{command} faults/plant_frozen", "", "faults: target = 'plant'")
      for command in ("compare", "simulate")],
    *[(f"tune --laws smc --workers 1 {options}", "", text) for options, text in (
        ("--delays 5,9", "--delays: must be left out unless --for margin"),
        ("--for margin --travel-limit 5", "--travel-limit: must be left out"),
        ("--for fun", "goal = 'fun'"), ("--budget 1", "budget = 1"),
        ("--laws smcc", "did you mean smc?"))],
    *[(f"datasheet paper_arm --quick {options}", "", text) for options, text in (
        ("--network nowhere", "nowhere"), ("--law smcc", "did you mean smc?"),
        ("--windows 8", "--windows 8: needs --network"),
        ("--set duration_s=abc", "duration_s"))],
    *[(f"link {options}", "", text) for options, text in (
        ("", "give a HOST, or --serve"), ("somewhere --serve", "give a HOST, or --serve"),
        ("127.0.0.1 --size 10", "--size 100 to 60000"),
        ("127.0.0.1 --tcp --zenoh", "give --tcp or --zenoh, not both"),
        ("127.0.0.1 --rate 0", "--rate must be up to 10000 Hz"))],
    ("robot-server ur5e", "", "did you mean ur5e_motors?"),
    ("robot-server --interface joint_trajectory", "", "must be one of"),
    ("robot-server --vendor xram", "", "did you mean xarm?"),
    ("simulate UR10E_Motor", "", "did you mean ur10e_motors?"),
    ("benchmark --predictors smiht", "", "did you mean smith?"),
    # gates
    ("simulate --at-least 20Hz", "", "unit 'Hz': must be %"),
    ("margin --at-least 20%", "", "unit '%': must be ms"),
    ("margin --at-least 20", "", "--at-least 20: must have a unit: write 20ms"),
    ("simulate --at-least 20", "", "--at-least 20: must have a unit: write 20% or 20mm or 20ms or"),
    ("datasheet --interface servoj --at-least 20", "", "must have a unit: write 20ms or 20mm"),
    ("margin --tolerance 1", "", "--tolerance 1: must have a unit: write 1ms or 1%"),
    ("margin --at-least 20ms --limit 16", "", "at most 16 ms, the last value tried (--limit)"),
    ("margin --at-least 129ms", "", "--at-least 129 ms: must be at most 128 ms, the last value"),
    ("margin --at-least 5ms --plants 3 --values 2,4 --uncertainty half", "",
     "at most 4 ms, the last value tried (--values)"),
    ("policy funnel_hil:Demonstrator paper_arm_mit --merges replace --at-least 301ms", "",
     "at most 300 ms, the last value tried (--limit)"),
    *[(f"datasheet {options}", "", f"must be at most {most} ms, the largest value that a data sheet"
       " tries (funnel-hil margin --limit tries more): no result can pass") for options, most in (
        ("--at-least 129ms", 128), ("--interface servoj --at-least 501ms", 500))],
    ("margin --at-least much", "", "--at-least 'much': must be a number"),
    ("sweep delay_sweep --tolerance 1%", "", "needs --baseline"),
    ("compare --baseline nowhere.json", "", "nowhere.json: No such file or directory: must be"),
    # what is set
    *[(f"run --set {text}", f"--set {text}:") for text in ("duration_s", "=2", "duration_s=[")],
    *[(f"{command} paper_arm --set link.uplink.delay_ms=-1", "", "link.uplink.delay_ms = -1")
      for command in ("run", "simulate", "controller", "plant", "record")],
    ("run --set link.uplink.distribution=empirical --set link.uplink.jitter_ms=2", "",
     "link.uplink.distribution_file = null: must be a file of delays in ms",
     "link.uplink.jitter_ms = 2: must be left at 0"),
    ("simulate iiwa_can --set seed=3 --set link.can.fd=false",
     "--set link.can.fd=false: link.can.fd = False"),
    *[(f"simulate {scenario} --set seed=3 --set {given}",
       f"{SHIPPED / scenario}.yaml, with --set {given}: {text}")
      for scenario, given, text in (  # names both, as either may be meant
          ("iiwa_can", "link.can.protocol=cansimple", "link.can.fd_process_data = True"),
          ("paper_arm_can", "link.can.bitrate=125000", "rate_hz = 500.0"),
          ("paper_arm", "duration_s=600", "reference = "))],
]  # fmt: skip
OUT_OF_RANGE = [
    # a command line, the option that its usage names
    ("view --speed 0 nowhere", "--speed"), ("view --port 70000 nowhere", "--port"),
    ("margin --workers 0", "--workers"), ("datasheet paper_arm --plants -1", "--plants"),
]  # fmt: skip
DEEPER = "must not be nested deeper than 50 levels"
NO_YAML = [
    # value of seed, message
    ("2024-13-45", "seed = '2024-13-45': must be a valid date"),
    ("!!int z", "seed = 'z': must be a whole number"),
    ("!!float z", "seed = 'z': must be a number"),
    ("[!!bool z]", "seed.0 = 'z': must be a valid bool"),
    ("9" * 5000, r"seed = '9+\.\.\.: must be a whole number"),
    ("0x" + "f" * 5000, r"seed = '0xf+\.\.\.: must be a whole number"),
    ("[" * 500 + "]" * 500, f"seed = 'line .*{DEEPER}"),
    # libyaml reads 1024 characters ahead, and some versions have a limit of their own
    ("[" * 100_000, f"(seed = 'line .*{DEEPER}|cannot be read as YAML: .*nesting depth)"),
    ("&a [*a]", r"seed = '\*a': must not contain itself"),
    ("true", "seed = True: must be a number, not true or false"),
    ("yes", r"seed = True: must be a number, not true or false \(in YAML also yes, no, on, off\)"),
    ("010", "seed = '010': must be a number without a leading 0, .* YAML reads it as 8"),
    ("-0_10", "seed = '-0_10': must be a number without a leading 0, .* YAML reads it as -8"),
    ("[1, 1:30]", "seed.1 = '1:30': must be a number without colons, .* YAML reads it as 90"),
    ("1:30.5", "seed = '1:30.5': must be a number without colons, .* YAML reads it as 90.5"),
    ("0o10", "seed = '0o10': must be a valid integer"),
]
TYPOS = [
    # key as given, as far as it is known, what may have been meant
    ("duration", "duration", "duration_s"),
    ("link.uplink.delay", "link.uplink.delay", "delay_ms"),
    ("linc.uplink.delay_ms", "linc", "link"),
    ("paylod_kg", "paylod_kg", "plant.payload_kg"),
    ("controller.gains.pid.proportinal", "controller.gains.pid.proportinal", "proportional"),
    ("reference.x.ofset_m", "reference.cartesian_path.x.ofset_m", "offset_m"),
    ("controller.gains.magic", "controller.gains.magic", None),
    ("a.b", "a", None),
]
MISSPELT = [
    # a command line, what may have been meant
    ("margin --quantity dely", "delay"),
    ("margin --quantity link.uplink.delay", "link.uplink.delay_ms"),
    ("margin --quantity paylod_kg", "plant.payload_kg"),
    ("margin --direction uplnk", "uplink"),
    ("margin --study delay_margn", "delay_margin"),
    ("sweep delay_swep", "delay_sweep"),
    ("simulate papr_arm", "paper_arm"),
    ("simulate faults/encoder_stik", "faults/encoder_stuck"),
    ("simulate encoder_stuck", "faults/encoder_stuck"),
    ("simulate --set clock=lockstp", "lockstep"),
    ("simulate --set link.kind=zenho", "zenoh"),
    ("simulate --set link.can.protocol=cia40", "cia402"),
    ("simulate --set 'faults=[{kind: link_ct, at_s: 1}]'", "link_cut"),
    ("simulate --set robot.urdf=papr_arm", "paper_arm"),
    ("simulate --set robot.joints=[base_yaw,elbw]", "elbow"),
    ("simulate --set 'plant.disturbance.terms=[{joint: elbw, kind: constant, torque_nm: 1}]'",
     "elbow"),
    (f"simulate --set 'uncertainty={UNCERTAIN}'", "plant.payload_kg"),
]  # fmt: skip
