"""A xacro file of a stranger's: what it computes, and that it does nothing else."""

import os

import pytest

from bus_schema.errors import RobotDescriptionError
from bus_schema.urdf.xacro_files import INCLUDE, expanded

ROBOT = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">{}</robot>'
EXPLOIT = (
    "(lambda: [c for c in ().__class__.__base__.__subclasses__()"
    " if c.__name__=='_wrap_close'][0].__init__.__globals__['system']('touch PWNED') or 1)()"
)
MACRO = '<xacro:macro name="a" params="{}">{}</xacro:macro><xacro:a {}/>'
TWICE = "".join(
    f'<xacro:macro name="m{level}"><xacro:m{level - 1}/><xacro:m{level - 1}/></xacro:macro>'
    for level in range(1, 40)
)
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
    (folder / "bomb.yaml").write_text(
        "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n"
        + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 12))
    )
    (folder / "limits.yaml").write_text("j1: {max: 2.5}\nangle: !degrees 180\n")
    os.mkfifo(folder / "pipe")
    monkeypatch.setenv("STRANGER", "secret")
    monkeypatch.chdir(tmp_path)

    def of(text):
        (folder / "arm.xacro").write_text(ROBOT.format(text))
        try:
            return expanded(folder / "arm.xacro")
        finally:
            assert not (tmp_path / "PWNED").exists()

    return of


@pytest.mark.parametrize(
    ("text", "said"),
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
        (value("load_yaml('bomb.yaml')"), TOO_MUCH),
        ('<xacro:include filename="/etc/passwd"/>', "must be below"),
        ('<xacro:include filename="../secret.xml"/>', "must be below"),
        ('<xacro:include filename="link.xacro"/>', "must be below"),
        ('<xacro:include filename="/*/*/*/*/*/*/*"/>', "must be below"),
        ('<xacro:include filename="$(find etc)/passwd"/>', "no folder 'etc'"),
        ('<a v="$(env STRANGER)"/>', "environment variables"),
        (value("9**9**9"), TOO_MUCH),
        (value("python.vars(python.type)"), "vars"),
        (value("(" * 300 + ")" * 300), "parenthes"),
        (value("-" * 1500 + "1"), "recursion|too deep"),
        (MACRO.format("", "<xacro:a/>", ""), "nested too deep, or without an end"),
        ('<xacro:include filename="arm.xacro"/>', "nested too deep, or without an end"),
        (f'<xacro:macro name="m0"><b/></xacro:macro>{TWICE}<xacro:m39/>', TOO_MUCH),
        (value("load_yaml('pipe')"), "not a regular file"),
    ],
)
def test_refused_in_a_sentence_with_the_file(expand, text, said):
    with pytest.raises(RobotDescriptionError, match=f"arm.xacro: xacro: .*({said})") as caught:
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
