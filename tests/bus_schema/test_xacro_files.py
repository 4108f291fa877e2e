"""A xacro file of a stranger's: what it computes, and that it does nothing else."""

import os

import pytest

from bus_schema.errors import RobotDescriptionError
from bus_schema.runtime.limited_process import LimitedProcess
from bus_schema.urdf.packages import INCLUDE
from bus_schema.urdf.xacro_files import expanded

ROBOT = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">{}</robot>'
EXPLOIT = (
    "(lambda: [c for c in ().__class__.__base__.__subclasses__()"
    " if c.__name__=='_wrap_close'][0].__init__.__globals__['system']('touch PWNED') or 1)()"
)
MACRO = '<xacro:macro name="a" params="{}">{}</xacro:macro><xacro:a {}/>'
TOO_MUCH = "takes more time or memory than an arm may"


def value(expression):
    return f'<a v="${{{expression}}}"/>'


@pytest.fixture
def expand(tmp_path, monkeypatch):
    folder = tmp_path / "given"
    folder.mkdir()
    (tmp_path / "secret.xml").write_text("<robot><secret/></robot>")
    (tmp_path / "secret.yaml").write_text("secret: 1")
    (folder / "link.xacro").symlink_to(tmp_path / "secret.xml")
    (folder / "limits.yaml").write_text("j1: {max: 2.5}\nangle: !degrees 180\n")
    os.mkfifo(folder / "pipe")
    monkeypatch.setenv("STRANGER", "secret")
    monkeypatch.chdir(tmp_path)

    def of(text, arguments=None, include=()):
        (folder / "arm.xacro").write_text(ROBOT.format(text))
        try:
            return expanded(folder / "arm.xacro", arguments or {}, include)
        finally:
            assert not (tmp_path / "PWNED").exists()

    return of


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (value(EXPLOIT), "Lambda is not among"),
        (f'<a v="$(eval {EXPLOIT})"/>', "invalid syntax|never closed"),
        (value("[c for c in (1,2)]"), "ListComp is not among"),
        (value("''.__class__"), "__class__ is not among"),
        (value("str.mro()"), "mro is not among"),
        (value("'a'.format(1)"), "format is not among"),
        (value("open('/etc/passwd')"), "'open' is not defined"),
        (value("xacro.load_yaml('../secret.yaml')"), "must be below"),
        (value("load_yaml('/etc/passwd')"), "must be below"),
        ('<xacro:include filename="/etc/passwd"/>', "must be below"),
        ('<xacro:include filename="../secret.xml"/>', "must be below"),
        ('<xacro:include filename="link.xacro"/>', "must be below"),
        ('<xacro:include filename="/*/*/*/*/*/*/*"/>', "must be below"),
        ('<xacro:include filename="$(find etc)/passwd"/>', "no folder 'etc'"),
        ('<a v="$(env STRANGER)"/>', "environment variables"),
        (value("9**9**9"), TOO_MUCH),  # 3 s of CPU time, as all that has no end costs
        (value("python.vars(python.type)"), "vars"),
        (value("(" * 300 + ")" * 300), "parenthes"),
        (value("-" * 1500 + "1"), "recursion|too deep"),
        (MACRO.format("", "<xacro:a/>", ""), "nested too deep, or without an end"),
        ('<xacro:include filename="arm.xacro"/>', "nested too deep, or without an end"),
        (value("load_yaml('pipe')"), "not a regular file"),
    ],
)
def test_refused_in_a_sentence_with_the_file(expand, text, message):
    with pytest.raises(RobotDescriptionError, match=f"arm.xacro: xacro: .*({message})") as caught:
        expand(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (value("2*pi/4 + sin(0) - -1"), "2.5707963267948966"),
        (value("math.sqrt(4) if 1 &lt; 2 and not False else 0"), "2.0"),
        (value("dict(a=[1, 2.5])['a'][-1]"), "2.5"),
        (value("max(len('abc'), 2) // 2"), "1"),
        (value("'%.2f' % pi + '_'.join(['a', 'b']).upper()"), "3.14A_B"),
        (value("load_yaml('limits.yaml').j1.max"), "2.5"),
        (value("xacro.load_yaml('limits.yaml')['angle']"), "3.141592653589793"),
        (value("[4, 5].pop(0)"), "4"),
        (value("dict(a=3).pop('a')"), "3"),
        ("""<xacro:property name="L" value="${['a', 'b']}"/><xacro:property name="n"
         value="${L.pop(0)}"/><a v="${n}${L.index('b')}"/>""", "a0"),
        ('<a v="$(optenv STRANGER none)"/>', "none"),
        ('<xacro:arg name="n" default="3"/><a v="$(eval 2*n + 1)"/>', "7"),
        (MACRO.format("x y:=${4*2} *b", '<a v="${y}"><xacro:insert_block name="b"/></a>', 'x="4"')
         .replace('x="4"/>', 'x="4"><c/></xacro:a>'), "8"),
        ('<xacro:if value="${1 == 1}"><a v="yes"/></xacro:if>', "yes"),
        ('<xacro:unless value="${1 == 1}"><a v="no"/></xacro:unless><a v="yes"/>', "yes"),
    ],
)  # fmt: skip
def test_what_xacro_documents_is_computed(expand, text, expected):
    assert f'<a v="{expected}"' in expand(text)


def test_folders_that_the_user_names_may_be_included_from(expand, tmp_path, monkeypatch):
    monkeypatch.setenv(INCLUDE, os.pathsep.join(["/nowhere", str(tmp_path)]))
    assert "<secret/>" in expand('<xacro:include filename="../secret.xml"/>')


@pytest.mark.parametrize("name", ["..", ".", "../package", "/"])
def test_no_package_is_a_way_out_of_the_folders_that_the_user_names(
    expand, tmp_path, monkeypatch, name
):
    (tmp_path / "named").mkdir()
    monkeypatch.setenv(INCLUDE, str(tmp_path / "named"))
    with pytest.raises(RobotDescriptionError, match="no folder"):
        expand(f'<xacro:include filename="$(find {name})/secret.xml"/>')


def test_expansion_has_a_session_of_its_own_where_no_terminal_interrupts_it(tmp_path, monkeypatch):
    (tmp_path / "session.py").write_text("import os; print(os.getsid(0) == os.getpid())")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert LimitedProcess("session", b"").answer() == b"True\n"


ARGUMENT = '<xacro:arg name="kind" default="b"/><a v="$(arg kind)"/>'


@pytest.mark.parametrize("value", ["c", "", "${open('/etc/passwd')}", "$(env STRANGER)", '"/>'])
def test_argument_replaces_the_default_and_is_only_a_text(expand, value):
    text = expand(ARGUMENT, {"kind": value})
    assert "secret" not in text
    assert "root:" not in text
    assert value not in ("c", "") or f'<a v="{value}"' in text


def package(folder, name, **files):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "package.xml").write_text(f"<package><name>{name}</name></package>")
    for file, text in files.items():
        (folder / f"{file}.yaml").write_text(text)


LOADS = '<xacro:property name="v" value="${{load_yaml(\'{}\')}}"/><a v="${{v.max}}"/>'
IN_PACKAGE = LOADS.format("$(find described)/$(arg kind).yaml").replace(
    "load_yaml('$(find described)/$(arg kind).yaml')", "load_yaml(file)"
)
IN_PACKAGE = '<xacro:property name="file" value="$(find described)/$(arg kind).yaml"/>' + IN_PACKAGE


@pytest.mark.parametrize("folder", ["given", "given/../beside", "group/deep/other"])
def test_package_is_found_by_the_name_in_its_file(expand, tmp_path, folder):
    (tmp_path / ".git").mkdir()
    package(tmp_path / folder, "described", k1="max: 7")
    assert '<a v="7"' in expand('<xacro:arg name="kind" default="k1"/>' + IN_PACKAGE)


@pytest.mark.parametrize("variable", ["AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH"])
def test_package_is_found_where_ros_looks_for_it(expand, tmp_path, monkeypatch, variable):
    elsewhere = tmp_path / "elsewhere"
    package(elsewhere / "share" / "described", "described", k1="max: 7")
    monkeypatch.setenv(variable, str(elsewhere))
    assert '<a v="7"' in expand(IN_PACKAGE, {"kind": "k1"})


def test_package_is_found_below_a_folder_that_the_scenario_names(expand, tmp_path):
    package(tmp_path / "elsewhere" / "src" / "some", "described", k1="max: 7")
    with pytest.raises(RobotDescriptionError, match=r"no folder 'described'.*robot\.include"):
        expand(IN_PACKAGE, {"kind": "k1"})
    assert '<a v="7"' in expand(IN_PACKAGE, {"kind": "k1"}, [tmp_path / "elsewhere"])


def test_missing_package_is_no_error_where_nothing_is_read_from_it(expand):
    assert '/controllers.yaml"' in expand('<a v="$(find controllers)/controllers.yaml"/>')


@pytest.mark.parametrize(
    ("text", "arguments", "message"),
    [
        ('<a v="$(arg kind)"/>', {}, r"argument kind: kind:=… gives it"),
        (IN_PACKAGE, {}, r"argument kind: kind:=… gives it.*; its files know k1, k2, limits$"),
        (IN_PACKAGE, {"kind": "k3"}, r"the argument kind is 'k3'; its files know k1, k2, limits$"),
        (
            "<xacro:if value=\"${'$(arg kind)' == 'long'}\"/>",
            {},
            "files compare it with long$",
        ),
        (
            '<!-- <xacro:arg name="old" default=""/> --><xacro:arg name="kind" default="k1"/>'
            "<xacro:arg default='a b' name='prefix'/>"
            f'<xacro:arg name="file" default="$(arg kind)"/><a v="$(arg serial)"/>{IN_PACKAGE}',
            {},
            r"argument serial: serial:=… gives it; arguments and their defaults:"
            r" kind:=k1 \(its files know k1, k2, limits\), prefix:=a b, file$",
        ),
    ],
)
def test_missing_or_unknown_argument_is_named_with_choices(
    expand, tmp_path, text, arguments, message
):
    package(tmp_path / "given", "described", k1="max: 7", k2="max: 8")
    with pytest.raises(RobotDescriptionError, match=message):
        expand(text, arguments)


def test_file_is_expanded_again_only_when_one_that_it_reads_has_changed(
    expand, tmp_path, monkeypatch
):
    part = tmp_path / "given" / "part.xacro"
    part.write_text(ROBOT.format('<link name="one"/>'))
    text = expand('<xacro:include filename="part.xacro"/>')
    arm, started = tmp_path / "given" / "arm.xacro", []
    answer = LimitedProcess.answer
    monkeypatch.setattr(
        LimitedProcess, "answer", lambda process: started.append(1) or answer(process)
    )
    assert expanded(arm, {}, ()) == text
    assert not started
    part.write_text(ROBOT.format('<link name="another"/>'))
    assert 'name="another"' in expanded(arm, {}, ())
    assert 'name="another"' in expanded(arm, {"unused": "1"}, ())
    assert len(started) == 2
    part.unlink()
    with pytest.raises(RobotDescriptionError, match=r"part\.xacro"):
        expanded(arm, {}, ())
