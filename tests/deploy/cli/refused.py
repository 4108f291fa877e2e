"""The table of what is refused, and what is said of it.

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
DELAYS = "link.downlink={distribution: empirical, distribution_file: %s}"
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
    "of_a_fault.yaml": "extends: faults/encoder_stuck\n",
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
    "file": "",
}
REFUSED = [
    # scenarios and files
    ("run paper_leg", "paper_leg: ", "paper_arm"),
    ("simulate nowhere", "nowhere: ", "paper_arm_mit, ur5e_motors, faults/*"),
    ("simulate faults/nothing_like_it", "faults/nothing_like_it: ",
     "faults/actuator_dead, faults/actuator_weak"),
    ("simulate /dev/null", "/dev/null: is no regular file, nor one of the shipped"),
    ("simulate .", ".: is no regular file, nor one of the shipped"),
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
    ("run of_a_fault.yaml", "of_a_fault.yaml: ", "must be a scenario that extends no other"),
    ("run twice.yaml", "twice.yaml: duration_s = ", "must be given once; ", "lines 2 and 4"),
    ("run inner.yaml", "inner.yaml: plant.payload_kg = ", "must be given once; "),
    ("sweep big.yaml", "big.yaml: ", "are 100000000 runs; at most 100000 are allowed"),
    ("sweep sweep.yaml", "sweep.yaml: grid plant.payload_kg=-1: "),
    ("sweep set.yaml", "set.yaml: set plant.paylod_kg=1: ", "mean payload_kg"),
    ("sweep typo.yaml", "typo.yaml: scenari", "did you mean scenario"),
    ("replay nothing", "nothing: "),
    ("report nothing", "nothing: "),
    ("replay damaged", "damaged", "no recording of funnel-hil"),
    ("report damaged", "damaged", "no recording of funnel-hil"),
    ("runs list nowhere", "nowhere: no such folder; must be one of results"),
    ("runs tag nowhere a", "nowhere: holds no results"),
    ("runs prune .", "", "must be given --older-than, --incomplete, or both"),
    ("robot nowhere.urdf", "", "nowhere.urdf"),
    ("reference paper_arm", "", "one of --csv and --parquet"),
    ("ros2-control paper_arm --out file", "", "cannot be written"),
    ("ros-package file", "", "cannot be written"),
    ("export damaged", "", "must be given --csv, --parquet, or both"),
    *[(f"{command} paper_arm --set link.security.enabled=true --set link.security.folder=/nowhere",
       "/nowhere/authority.crt: does not exist") for command in ("run", "controller", "record")],
    # over a real delay, and confirmed
    *[(f"run paper_arm --real-delay {given}", "--real-delay ", "must be a round trip of 0 to 1000")
      for given in ("1000.1", "nan")],
    *[(f"run {scenario} --real-delay 5 --set {setting}", "", said)
      for scenario, setting, said in (
          ("paper_arm", "clock=lockstep", "clock = 'lockstep': must be realtime"),
          ("paper_arm_can", "clock=realtime", "link.kind = 'can': must be zenoh"),
          ("paper_arm", "link.plant_endpoint=udp/127.0.0.1:7451", "must be tcp/ or"),
          ("paper_arm", "link.router_endpoint=tcp/127.0.0.1:7447", "must be left out"))],
    ("relay nowhere 127.0.0.1:1 --delay 1", "", "'nowhere': must be HOST:PORT"),
    ("relay 127.0.0.1:1 127.0.0.1:2 --delay -1", "", "--delay -1: must be 0 to 1000 ms"),
    ("run --confirm --set clock=realtime", "", "clock = 'realtime': must be lockstep"),
    ("run --confirm --set clock=lockstep"
     " --set 'faults=[{kind: process_killed, target: plant, at_s: 1}]'", "", "must be without"),
    # where results go
    ("run --out file", "--out file: cannot be created"),
    ("run --out file/below", "--out file/below: cannot be created"),
    *[(f"{words} --out loop{below}", f"--out loop{below}: cannot be created")
      for words in ("simulate", "compare --laws pid", "margin --laws pid")
      for below in ("", "/below")],
    # options
    ("compare --laws pid,smcc", "--laws 'smcc': must be one of fixed_time_neural"),
    ("margin --laws pid,smcc", "--laws 'smcc': must be one of fixed_time_neural"),
    *[(f"margin {option} {given}", f"{option}: {shown}' is no YAML value")
      for option in ("--seeds", "--values", "--offsets", "--running")
      for given, shown in (("[", "'["), ("\udcff", r"'\udcff"))],  # the latter is no UTF-8
    ("margin --quantity temperature", ""),
    ("margin --quantity robot.initial_offset_rad", ""),  # one per joint
    *[(f"drives paper_arm --set link.can.interface=virtual --fault {fault}",
       f"--fault = '{fault}'", words)
      for fault, words in (
          ("drive:9@1s", "one of the nodes 1, 2, 3"), ("drive:2", "kind:node@time"),
          ("drive:2@1", "kind:node@time"), ("drive:2@-1s", "kind:node@time"),
          ("fire:2@1s", "drive, silent, encoder-frozen, over-temperature"))],
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
       f"{SHIPPED / scenario}.yaml, with --set {given}: {said}")
      for scenario, given, said in (  # said with both, as either may be meant
          ("iiwa_can", "link.can.protocol=cansimple", "link.can.fd_process_data = True"),
          ("paper_arm_can", "link.can.bitrate=125000", "rate_hz = 500.0"),
          ("paper_arm", "duration_s=600", "reference = "))],
]  # fmt: skip
FEEDBACK = "controller.drive_feedback.enabled=true"
ONE_EACH = "each of the 3 joints"
LONG_LINK = "must be without a change before the ramp ends at 3.0 s"
SET = [
    # --set of `run paper_arm`, how the message goes on after "--set …: ", what else is in it
    ("link.plant_endpoint=tcp/1.2.3.4:7000", "link.plant_endpoint = "),
    ("link.kind=in_process", "link.kind = 'in_process': must be zenoh"),
    ("link.security.folder=keys", "link.security.folder = 'keys': must be an absolute path"),
    ("link.plant_endpoint=tls/127.0.0.1:7451", "", "link.security.enabled true"),
    ("reference.x.offset_m=9", "", "must stay within the arm's reach and joint limits"),
    ("link.can.node_ids=3", "", ": must be a list of whole numbers"),
    ("robot.joints=elbow", "", ": must be a list of strings"),
    ("faults=1", "", ": must be a list of mappings of keys to values"),
    ("link.uplink.schedule=1", "", ": must be a list of mappings of keys to values"),
    ("plant.payload_kg=1e300", "", "must be less than or equal to"),
    ("plant.payload_kg=1e7", "", "must be less than or equal to 1000000"),
    ("controller.model_scale=1e308", "", "must be less than or equal to"),
    ("controller.model_scale=1e-9", "", "must be greater than or equal to"),
    ("plant.friction.coulomb_nm=1e13", "", "must be numbers of at most 1e+12 in size"),
    (f"robot.initial_offset_rad=1{'0' * 290}", "", "1e+12"),
    (f"name={LONG}", "", "must have at most 100 characters"),
    ("plant.disturbance.terms=[{joint: knee, kind: constant, torque_nm: 1}]", "",
     "plant.disturbance.terms.0.joint = 'knee'", "base_yaw, shoulder"),
    ("plant.disturbance.terms=[{joint: all, kind: noise, rms_nm: 1, lowest_hz: 9, highest_hz: 2}]",
     "", "plant.disturbance.terms.0.highest_hz = 2.0", "above lowest_hz = 9.0"),
    ("plant.disturbance.terms=[{joint: all, kind: drum}]", "", "terms.0", "'sine'"),
    ("plant.disturbance.terms=[{joint: all, kind: constant}]", "",
     "plant.disturbance.terms.0.constant.torque_nm", "is missing"),
    ("link.uplink.schedule=[{kind: step, at_s: -1}]", "",
     "schedule.0.step.at_s = -1: must be greater than or equal to 0"),
    ("link.uplink.schedule=[{kind: step, at_s: 1, loss: 2}]", "",
     "schedule.0.step.loss = 2: must be less than or equal to 1"),
    ("link.uplink.schedule=[{kind: outage, at_s: 1}]", "", "schedule.0.outage.for_s: is missing"),
    ("link.uplink.schedule=[{kind: jump, at_s: 1}]", "", "'step', 'ramp', 'outage'"),
    ("link.uplink.schedule=[{kind: step, at_s: 2, loss: 0}, {kind: step, at_s: 1, loss: 0}]", "",
     "must be in increasing order of at_s; 1.0 follows 2.0"),
    ("link.uplink.schedule=[{kind: ramp, at_s: 1, for_s: 2, loss: 1},"
     " {kind: step, at_s: 2, loss: 0}]", "", LONG_LINK),
    (DELAYS % "none.txt", "", "link.downlink.distribution_file = ", "none.txt", "cannot be read"),
    (DELAYS % "HERE/no_delays.txt", "", "no_delays.txt", "holds no delay"),
    (DELAYS % "HERE/negative.txt", "", "negative.txt", "line 2: a delay is at least 0"),
    ("robot.urdf=HERE/jointless.urdf", "robot.urdf = ", "no revolute or continuous joint"),
    ("robot.urdf=HERE/half.urdf", "robot.urdf = ", "cannot be read as URDF"),
    ("robot.urdf=HERE/model.urdf", "robot.urdf = ", "no URDF"),
]  # fmt: skip
OVER_CAN = [
    # scenario, settings of its `run`, what is in the message
    *[("paper_arm_can", setting, said) for setting, said in (
        ("link.can.interface=nope", "'nope': must be one that python-can knows"),
        ("link.can.interface=virtual", "'virtual': reaches no other process"),
        ("link.can.channel=10.0.0.1", "'10.0.0.1': must be a multicast address"),
        ("link.can.bitrate=42", "42: must be 125000, 250000, 500000, 800000 or 1000000"),
        ("link.can.node_ids=[1, 2, 2]", "given more than once: [2]"),
        ("link.can.node_ids=[1, 2]", f"one for {ONE_EACH}"),
        ("link.can.rated_torque_nm=[1, 2]", f"one for {ONE_EACH}"),
        ("link.can.protocol=canasta", "'cia402', 'cansimple', 'mit' or 'damiao'"),
        ("link.can.eds=/etc/hostname", "'/etc/hostname': must be a file that is an EDS"),
        ("link.can.faults.drives=['drive:9@1s']", "must name one of the nodes 1, 2, 3"),
        ("rate_hz=2000", "the nearest rate that fits is 1000 Hz"),
        ("link.uplink.jitter_ms=1", "link.uplink = {'jitter_ms': 1.0}: must be delay_ms alone"),
        ("link.downlink.loss=0.1", "link.downlink = {'loss': 0.1}: must be delay_ms alone"),
        ("link.playout_ms=9", "link.playout_ms = 9.0: must be left out"),
        ("link.uplink.delay_ms=1 & clock=realtime", "must be without delays where clock is real"),
        ("link.downlink.delay_ms=1 & link.can.protocol=mit", "must be without delays with MIT"),
        (f"{FEEDBACK} & link.can.protocol=cansimple",
         "link.can.cansimple.input_torque_scale = 1000"),
        (f"{FEEDBACK} & plant.drive_feedback.damping_nm_s=0",
         "plant.drive_feedback.damping_nm_s = 0"),
        (f"{FEEDBACK} & rate_hz=1000", "RPDOs 8 and 4 bytes"))],
    ("iiwa_can", "link.can.fd=false", "link.can.fd = False: must be true with"),
    ("iiwa_can", "link.can.protocol=cansimple", "must be false with"),
    ("iiwa_can", "rate_hz=2000", "of data with stuffing"),
    *[("paper_arm_mit", setting, said) for setting, said in (
        ("link.can.mit.torque_nm=[1, 2]", ONE_EACH),
        ("link.can.mit.reply_bytes=7", "link.can.mit.reply_bytes"),
        ("link.can.mit.reply_identifier=2", "mit.reply_identifier = 2: must be none"),
        (f"{FEEDBACK} & link.can.mit.stiffness_nm_rad=500", "link.can.mit.stiffness_nm_rad = "),
        ("rate_hz=1000", "3 × (request 8 bytes + command 8 bytes + 2 replies of 8 bytes)"))],
    *[("openarm", setting, said) for setting, said in (
        ("link.can.damiao.motor=DM9000", "'DM4310', 'DM4310_48V', 'DM4340', 'DM4340_48V' or 'DM8"),
        ("link.can.damiao.motor=[DM4310, DM4340]", "one, or one for each of the 7 joints"),
        ("link.can.damiao.feedback_ids=[17, 18]", "one for each of the 7 joints"),
        ("link.can.damiao.feedback_ids=[17, 18, 18, 20, 21, 22, 23]", "more than once: [18]"),
        ("link.can.damiao.feedback_ids=[17, 18, 19, 20, 21, 22, 258]", "commands go: the addresses,"
         " those plus 0x100, 0x200 and 0x300, and 0x7FF; [258] are"),
        ("link.can.node_ids=[1, 2, 3, 4, 5, 6, 17]", "[17] are"),
        ("rate_hz=1000", "3220 of data with stuffing = 1568 µs at 1000 kbit/s and 5000 kbit/s"),
        ("link.can.fd_process_data=false", "3780 µs at 1000 kbit/s"),
        (FEEDBACK, "stiffness_nm_rad of link.can.damiao.motor = [500.0"))],
]  # fmt: skip
IMPOSSIBLE = [
    # key, value as given, as the message shows it, what the message says is allowed
    ("controller.delay_compensation.observer_bandwidth_rad_s", "0", "0", "greater than 0"),
    ("controller.delay_compensation.enabled", "perhaps", "'perhaps'", "a valid boolean"),
    ("controller.delay_compensation.expected_round_trip_ms", "-1", "-1", "greater than or equal"),
    ("plant.drive_feedback.stiffness_nm_rad", "-1", "-1", "at least 0"),
    ("duration_s", "abc", "'abc'", "a valid number"),
    ("duration_s", "0", "0", "greater than 0"),
    ("duration_s", ".nan", "nan", "a finite number"),
    ("duration_s", "1000000000", "1000000000", "must"),
    ("rate_hz", "0.5", "0.5", "greater than or equal to 1"),
    ("seed", "1.5", "1.5", "a valid integer"),
    ("seed", "-1", "-1", "greater than or equal to 0"),
    ("clock", "fast", "'fast'", "'realtime' or 'lockstep'"),
    ("link.kind", "pigeon", "'pigeon'", "zenoh"),
    ("link.uplink.delay_ms", "-1", "-1", "greater than or equal to 0"),
    ("link.uplink.loss", "1.5", "1.5", "less than or equal to 1"),
    ("link.uplink.distribution", "cauchy", "'cauchy'", "'uniform', 'normal', 'pareto' or 'emp"),
    ("link.uplink.rate_kbit_s", "0", "0", "greater than 0"),
    ("link.uplink.burst_loss", "{p: 0.1}", "{'p': 0.1}", "p and r, or mean_loss and mean_burst"),
    ("link.uplink.burst_loss.r", "0", "0", "greater than 0"),
    ("link.uplink.burst_loss.mean_burst", "0.5", "0.5", "greater than or equal to 1"),
    (
        "link.uplink.burst_loss",
        "{mean_loss: 0.9, mean_burst: 2}",
        "{'mean_loss': 0.9, 'mean_burst': 2}",
        "at most mean_burst / (mean_burst + 1)",
    ),
    ("link.uplink.distribution_file", "a.txt", "'a.txt'", "unless distribution is 'empirical'"),
    ("link.playout_ms", "-1", "-1", "greater than or equal to 0"),
    ("link.router_endpoint", "nowhere", "'nowhere'", "tcp/127.0.0.1:7451"),
    ("robot.urdf", "nowhere.urdf", "'nowhere.urdf'", "no such file"),
    ("robot.initial_offset_rad", "[0, 0, -2]", "[0.0, 0.0, -2.0]", "opens to 1.5 rad"),
    ("robot.initial_offset_rad", "[9, 0, 0]", "[9.0, 0.0, 0.0]", "[-3.1, 3.1]"),
    ("robot.initial_offset_rad", "[0.1, 0.1]", "[0.1, 0.1]", ONE_EACH),
    ("funnel.final_rad", "1", "[1.0, 1.0, 1.0]", "must not exceed"),
    ("controller.law", "magic", "'magic'", "fixed_time_neural"),
    ("controller.gains.fixed_time_neural.k_1", "[1, 2]", "[1.0, 2.0]", ONE_EACH),
    ("controller.gains.fixed_time_neural.k_1", "-1", "-1", "at least 0"),
    ("plant.gui", "maybe", "'maybe'", "a valid boolean"),
    ("plant.friction.viscous_nm_s", "-1", "-1", "at least 0"),
    ("plant.actuator.saturation_nm", "[1, 2]", "[1.0, 2.0]", ONE_EACH),
]
DEEPER = "must not be nested deeper than 50 levels"
NO_YAML = [
    # what is written under seed, what is said of it
    ("2024-13-45", "seed = '2024-13-45': must be a date of the calendar"),
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
    (f"simulate --set 'uncertainty={UNCERTAIN}'", "plant.payload_kg"),
]
ARMS = [
    # in the URDF of paper_arm: what is replaced, by what, what is said
    ('child link="column"', 'child link="base"', "joins link 'base' to itself"),
    ('child link="upper_arm"', 'child link="forearm"', "the child of more than one joint"),
    ('parent link="base"', 'parent link="forearm"', "form a circle"),
    ('<link name="base">', '<link name="loose"/><link name="base">', "one link must be the child"),
    ('parent link="column"', 'parent link="nowhere"', "no link 'nowhere'"),
    ('name="shoulder" type', 'name="base_yaw" type', "joint names must be unique"),
    ('(?<="shoulder" type=)"revolute"', '"spherical"', "one of revolute, continuous"),
    ('axis xyz="0 1 0"', 'axis xyz="0 0 0"', "is no direction"),
    ('origin xyz="0.40 0 0"', 'origin xyz="0.40 0"', "must be three numbers"),
    ('mass value="33.429"', 'mass value="1e300"', "must be at most 1e"),
    ('mass value="33.429"', 'mass value="-1"', "must not be negative"),
    ('<mass value="33.429"/>', "", "must have one mass"),
    ("</robot>", "<a>" * 100_000 + "</a>" * 100_000 + "</robot>", "must not be nested deeper"),
    (r'(mass value|i[xyz]{2})="[^"]*"', r'\1="0"', "has no inertia"),
]
