from clustermcl.protocol.errors import AlreadyRunningError


def test_an_already_running_error_has_its_facts_as_attributes() -> None:
    second = AlreadyRunningError(
        what="a coordinator", robot="r1", endpoint="tcp/h:7447", advice="stop it"
    )
    assert str(second) == "robot 'r1' already has a coordinator at tcp/h:7447: stop it"
    router = AlreadyRunningError(what="a router", endpoint="tcp/h:7447", advice="stop it")
    assert str(router) == "tcp/h:7447 is in use: a router already listens there; stop it"
    assert (second.robot, router.robot) == ("r1", None)
