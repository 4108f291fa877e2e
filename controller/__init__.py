"""The controller: control laws, references and the loop that runs them."""
