"""What cannot become machine code here, and therefore runs on CasADi's evaluator."""

from flexhinf.errors import FlexhinfError


class Unsupported(FlexhinfError):
    """A traced function needs something for which no machine code can be made."""

    def __init__(self, what: str, found: str) -> None:
        super().__init__(what, found, "flexhinf.codegen.interpret runs the program on CasADi's evaluator")
