"""What of many runs stands for them."""

from deploy.study.statistics import commonest_error


def test_the_commonest_error_is_the_first_of_a_run_whatever_followed_from_it():
    errors = [
        "law my:Law failed at tick 50: boom; no valid command for 200 ms: safe stop",
        "law my:Law failed at tick 51: boom; the controller has left the bus",
        "no valid command for 200 ms: safe stop", None,
    ]  # fmt: skip
    said = commonest_error([{"error": error} for error in errors])
    assert said == "law my:Law failed at tick 50: boom"
